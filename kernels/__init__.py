"""Warp kernels of the method, each with its hand-written adjoint. Imports only Warp and NumPy.

A room a file, in the order in which an iteration goes through them:

    launching, sizes        how a launch runs or is recorded, and what it asks of its arguments, once
    ways, blocks, clusters  which way work goes on a device: in spans, or whole; threads that share a system
    warp_sums               what many threads add to few places, added up first
    levels, trilinear       where grid nodes lie; what they say at a point
    cayley, motion, chains  rotations; clouds and vertices moved by the grids, and back; in all transitions at once
    cells, packets          points sorted into cells; sixteen queries searched at a time
    neighbours              exact nearest neighbours on those, for chamfer and for pairs
    nearby                  the nearest fellows of a cloud's points, and the planes through them
    chamfer, isometry       the loss terms and their gradients
    confidence, schedule    how far a frame is trusted; what changes from one iteration to the next
    graphs                  which nodes smooth which
    cosine, cosine_blocks   the Sobolev solve on full grids; in blocks, with a whole step of the descent,
    cholesky                on the template, factorised once,
    cg                      and on any graph: cg_functions, cg_kernels in one block a system
    adam, finite            the step; whether numbers are still numbers
    vectors                 clear, copy, add and blend

Where the grids lose a frame, or one camera saw it: ``embedding``, a mesh bent by a few hundred nodes, whose steps
``embedding_serial`` solves.

The vertex stage, which begins where the grids end:

    pairs                   vertices and cloud points paired, as all of its terms see them
    planes, borders         residuals to the clouds, and across the border of an open mesh
    mixture                 noisy points, which ask all vertices around them
    unseen, landmarks       what holds a vertex where a frame has no points; where it is known to be
    rigidity                how edges turn with their vertices; on the CPU rotation_lanes, edge_lanes
    material                how stiff the surface is, vertex by vertex, by how it strained
    block_cg, block_serial  the solve for all moves at once; on one CPU core
    patches, fairing        places that are smooth in time, in patches of the surface; a shape without noise

Where a result is judged: ``closest_faces``, by Warp's own tree.

For a template without Poisson: ``tetrahedra`` (marching, on a deforming grid) and ``winding`` (inside a cloud or not).
"""
