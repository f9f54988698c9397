"""The fit, from clouds and a template in the cube to the vertices of all frames. Begin with ``run``.

A room a file, in the order in which a run goes through them:

    problem, measures, morton   what is given, laid out on the device; what is measured on it before a fit
    pool, workers               arrays handed out and counted; threads that run phases of tasks, or one graph
    branches                    tasks of a phase beside one another in that graph
    optimise, parameters        the descent on grids and template; values under the preconditioner, as Adam moves them
    sobolev                     which solver that is
    objective, terms            what is descended on, in its phases; a class a loss term
    chain, correspondences      the template moved through all frames, and back; who is nearest to whom

Where one camera saw a body that turns, the template itself comes of all frames first:

    growing                     outwards from the keyframe; where each frame is expected to have it
    surfels                     the surface known so far, as oriented points that bend
    hidden                      a limb that a frame hides, put as the frames around it show it

Where frames are sparse it is made again of all of them, after a first fit, and fitted once more:

    gathering                   their points taken back to the keyframe; which of both fits is the better one

Without the paper's chain the mesh then follows the grids, frame by frame:

    follow                      outwards from the keyframe, by ``refine`` and, what is lost, by ``recover``
    bending, transport          the same where one camera saw a part of the surface; matches that give each its share
    limb_search, limb_chains    limbs in many poses at once, where that leaves a fault; limbs as chains of links
    sliding                     a mesh that hangs over the end of its cloud goes back along itself
    recover, embedded           lost limbs found again by matches; a mesh bent by a few hundred rigid pieces

The vertex stage, which ends the fit:

    refine                      rounds of Gauss-Newton on every vertex of every frame, by
    pairing, unseen             pairs of points and mesh and their planes; what holds a vertex without points
    landmarks                   known places of the mesh, which lead a frame's start, too
    rest_shape                  one shape that all frames share
    material                    and how stiff it is, by how it strained in them
    smoothness                  patches of the surface, in which vertices move evenly in time

And around all of it ``run`` (what goes on when; stops, undone iterations) and ``saving`` (checkpoints in time).
"""
