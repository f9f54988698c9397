"""Sums within a warp before anything is added to memory: what many threads add to few places, on CUDA.

Atomic adds to one address are served one after the other. Thirty-two neighbouring threads mostly add to the same place
(points of one frame to its loss, points of one cell to its corners), so they first add up among themselves. Where they
do not, or where a warp is not complete, each adds on its own: right, only slower. The CPU, one thread, adds as ever.
"""

from __future__ import annotations

import warp as wp

from warpdef.kernels.launching import MODULE_OPTIONS

wp.set_module_options(MODULE_OPTIONS)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const unsigned all = 0xffffffffu;
    if (__activemask() == all) {
        int alike;
        __match_all_sync(all, slot, &alike);
        if (alike) {
            for (int o = 16; o > 0; o /= 2) value += __shfl_xor_sync(all, value, o);
            if (threadIdx.x % 32 == 0) atomicAdd(loss_out.data + slot, value);
            return;
        }
    }
    atomicAdd(loss_out.data + slot, value);
#else
    loss_out.data[slot] += value;
#endif
""")
def add_loss(slot: int, value: wp.float64, loss_out: wp.array[wp.float64]): ...


# Six numbers `given` of every thread of a warp, to be added to the eight corners of a cell by weights fx, fy, fz along
# its axes. In three steps partners exchange halves of the corners, so that each keeps half as many with twice as many
# threads in them: 54 exchanges, not 240. In the end a thread has the sum over the warp, `corner_sum`, of the corner
# that bits 16, 8 and 4 of its place say: along x, y, z. Threads that are not `mine` count as nothing, even if what
# they have is no number. F: a float, or 32 of them for a test without warps; the other capitals in the same terms.
CORNER_SUM = """
    F four[4][6], two[2][6], corner_sum[6];
    {
        const auto upper_x = (PLACE & 16) != 0, upper_y = (PLACE & 8) != 0, upper_z = (PLACE & 4) != 0;
        const F kept = PICK(upper_x, fx, 1.0f - fx), sent = PICK(upper_x, 1.0f - fx, fx);
        for (int k = 0; k < 4; ++k) {
            const F across = (k / 2 ? fy : 1.0f - fy) * (k % 2 ? fz : 1.0f - fz);
            for (int c = 0; c < 6; ++c) {
                const F part = given[c] * across;
                const F keep = PICK(mine, part * kept, NOTHING), send = PICK(mine, part * sent, NOTHING);
                four[k][c] = keep + SHUFFLE(send, 16);
            }
        }
        for (int k = 0; k < 2; ++k)
            for (int c = 0; c < 6; ++c)
                two[k][c] = PICK(upper_y, four[k + 2][c], four[k][c])
                    + SHUFFLE(PICK(upper_y, four[k][c], four[k + 2][c]), 8);
        for (int c = 0; c < 6; ++c) {
            F one = PICK(upper_z, two[1][c], two[0][c]) + SHUFFLE(PICK(upper_z, two[0][c], two[1][c]), 4);
            one = one + SHUFFLE(one, 2);
            corner_sum[c] = one + SHUFFLE(one, 1);
        }
    }
"""
