"""Break the core, one line at a time, and see whether the tests notice.

    python tests/break_core.py
    python tests/break_core.py --only 7

Every entry of ``BREAKS`` is a mistake that somebody could make: one line of ``kernels/`` or ``warpdef/fit/``, the test
files that must notice it, and what it is. All happens on a copy of the tree in a temporary folder, with a kernel cache
of its own that starts as a copy of the user's. The named tests must pass before anything is broken; then a break is

    caught      a test failed
    survived    all passed: a test sleeps
    unclear     nothing ran to its end (no tests found, the break cannot be imported, no end within the limit)
    stale       the text is not in its file exactly once: this table is behind the code

and all but the first make the exit code 1.
"""

from __future__ import annotations

import argparse
import logging
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SECONDS_MAX = 900.0  # for the tests of one break, its kernels compiled anew


@dataclass(frozen=True)
class Break:
    """One wrong line.

    file: from the root. old, new: text in a line of it, found there exactly once. tests: files that must notice, in
    ``tests/``, without prefix and suffix. reason: what is wrong then.
    """

    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    reason: str

    @property
    def found(self) -> int:
        """How often the text is in the tree."""
        return (ROOT / self.file).read_text().count(self.old)

    @property
    def paths(self) -> list[str]:
        return [f"tests/test_{name}.py" for name in self.tests]


# fmt: off
BREAKS = [
    Break("kernels/adam.py", "p[c] = p[c] - scale * adam", "p[c] = p[c] + scale * adam", ("adam",),
          "Adam climbs"),
    Break("kernels/schedule.py", "wp.pow(beta2, float(e + 1))", "wp.pow(beta2, float(e + 2))", ("schedule",),
          "bias correction of the step after"),
    Break("kernels/cayley.py", "return x + k * (c + wp.cross(z, c))", "return x + k * (c - wp.cross(z, c))",
          ("cayley",), "sign in the Cayley map"),
    Break("kernels/cayley.py", "wp.cross(x, wp.cross(adj, z))", "wp.cross(x, wp.cross(z, adj))", ("cayley",),
          "sign of the Cayley map's adjoint"),
    Break("kernels/chamfer.py", "return (2.0 * adj) * (", "return (-2.0 * adj) * (", ("chamfer",),
          "sign of the Chamfer gradient"),
    Break("kernels/chamfer.py", "normals[i], tangential, w * weight[s])", "normals[i], tangential, w)", ("chamfer",),
          "a dropped weight of the term"),
    Break("kernels/chamfer.py", "return wp.exp(-alpha * x)", "return wp.exp(-x)", ("chamfer",),
          "robust weight without its alpha"),
    Break("kernels/chamfer.py", "w = wp.exp(-x * x)", "w = wp.exp(-x)", ("chamfer",),
          "way-back weight of the wrong power"),
    Break("kernels/confidence.py", "wp.float64(1.0) + excess, -delta)", "wp.float64(1.0) + excess, delta)",
          ("schedule",), "bad frames are trusted more"),
    Break("warpdef/fit/objective.py", "confidence(loss.confidence, mean,", "confidence(False, mean,", ("objective",),
          "confidence off"),
    Break("kernels/isometry.py", "(after > 0.0f) - (after < 0.0f);", "(after < 0.0f) - (after > 0.0f);", ("isometry",),
          "isometry's sign towards the next frame, by vertices"),
    Break("kernels/isometry.py", "adj_vertices_out, t, j, -g)", "adj_vertices_out, t, j, g)", ("isometry",),
          "isometry's sign at an edge's other end, by edges"),
    Break("kernels/trilinear.py", "*(two*)(q + sx) += h1 - h11;", "*(two*)(q + sx) += h1;", ("trilinear",),
          "trilinear weight of a corner, on the way back"),
    Break("kernels/motion.py", "adj_plain[target, i] + carry[carry_target, i]", "adj_plain[target, i]", ("motion",),
          "the chain carries nothing back"),
    Break("kernels/motion.py", "+ rotate_along(z, x, zy)", "+ rotate_along(z, x, zx)", ("motion",),
          "derivative along the wrong axis"),
    Break("warpdef/fit/chain.py", "to = spare if source == ends.keyframe and transitions is ends.backward else source",
          "to = source", ("objective",), "two chains write one row of carry at the keyframe"),
    Break("warpdef/fit/problem.py", "int(offsets[last] - offsets[first])", "int(offsets[last] - offsets[first]) - 1",
          ("objective",), "a span is one short"),
    Break("kernels/packets.py", "(d_sq == best_sq) & (found < best)", "(d_sq == best_sq) & (found > best)",
          ("neighbours",), "ties go to the highest index, in packets"),
    Break("kernels/neighbours.py", "d_sq == best_sq && found < best", "d_sq == best_sq && found > best",
          ("neighbours",), "ties go to the highest index, one by one"),
    Break("kernels/cg_functions.py", "(1.0 + weight * float(end - begin))", "(1.0 + float(end - begin))", ("cg",),
          "no lambda on the solver's diagonal"),
    Break("kernels/cosine.py", "lambda_ * (mu[x] + mu[y] + mu[z])", "lambda_ * (mu[x] + mu[y])", ("cosine",),
          "grids are smoothed along two axes"),
    Break("warpdef/fit/optimise.py", "np.arange(grid.coarsest - 1, grid.levels)",
          "np.arange(grid.coarsest, grid.levels + 1)", ("optimise",), "learning rates of the next finer level"),
    Break("warpdef/fit/terms.py", "_REACH_SPACINGS = 1.0", "_REACH_SPACINGS = 1.5", ("objective",),
          "reach of the way back"),
    Break("warpdef/fit/problem.py", "kept_nodes(self.levels, [clouds[a], clouds[b]],",
          "kept_nodes(self.levels, [clouds[a]],", ("problem",), "pruning looks at one end of a transition"),
    Break("warpdef/fit/measures.py", "sizes, self._share, self", "sizes, 0.5 * self._share, self", ("refine_partial",),
          "half a surface is taken for all of it"),
    Break("kernels/rigidity.py", "turned = 0.5 * (", "turned = 1.0 * (", ("rigidity",),
          "rigidity's half"),
    Break("kernels/borders.py", "(w * (gap[t] - wp.dot(b, d)))", "(w * (-wp.dot(b, d)))", ("borders",),
          "no gap between a border and its points"),
    Break("warpdef/fit/rest_shape.py", "blend(c.shape_step,", "blend(1.0,", ("refine",),
          "the shape takes a whole step"),
    Break("kernels/planes.py", "rhs = (-w * wp.dot(a, pairs", "rhs = (w * wp.dot(a, pairs", ("planes",),
          "planes push"),
    Break("kernels/mixture.py", "part = weight / total", "part = weight", ("mixture",),
          "a noisy point asks each vertex around it for all"),
    Break("warpdef/geometry/denoise.py", "return x + move * n,", "return x - move * n,", ("denoise",),
          "noisy points move off their surface"),
    Break("kernels/unseen.py", "p + wp.transpose(turn) * (p - q)", "p + turn * (p - q)", ("unseen",),
          "a screw motion goes on the wrong way round"),
    Break("kernels/block_cg.py", "turn = ratio(sums[1], rz)", "turn = ratio(sums[0], rz)", ("block_cg",),
          "directions turned by the plain residual"),
    Break("warpdef/fit/terms.py", "<= bound * self._floor", "<= 2.0 * bound * self._floor", ("guide_arrives",),
          "a guide stops at twice what is left"),
    Break("kernels/edge_lanes.py", "total *= 0.5f / ", "total *= 1.0f / ", ("rigidity",),
          "the shape's half, on the CPU"),
    Break("kernels/edge_lanes.py", "there += weight * (xi", "there += (xi", ("rigidity",),
          "edges pull by their own stiffness, and back by one, on the CPU"),
    Break("kernels/block_serial.py", "stiff[i] * sum + total", "stiff[i] * sum", ("block_cg",),
          "an edge is as stiff as one of its ends"),
    Break("kernels/material.py", "(float(vertices.shape[0]) * whole)", "whole", ("material",),
          "strain grows with the number of frames"),
    Break("kernels/rotation_lanes.py", "const float w = tie *", "const float w = 2.0f * tie *", ("rigidity",),
          "neighbours tied twice as firmly, on the CPU"),
    Break("kernels/rotation_lanes.py", "const whole still = good & (4.0f * size < STILL);", "const whole still = good;",
          ("rigidity",), "sixteen rotations, after a single step"),
    Break("kernels/block_serial.py", "w + 3 * i, load(q + 3 * i)", "w + 3 * i, load(p + 3 * i)", ("block_cg",),
          "on one core, directions without their blocks"),
    Break("kernels/cells.py", "odometer.data[group] += ", "odometer.data[group] = ", ("neighbours",),
          "targets' moves are forgotten"),
    Break("kernels/packets.py", "- 1.0001f * drift", "- 0.5f * drift", ("neighbours",),
          "an old answer is trusted for too long"),
    Break("warpdef/fit/sobolev.py", "np.arange(config.grid.coarsest - 1, config.grid.levels)",
          "np.arange(config.grid.coarsest, config.grid.levels + 1)", ("sobolev",), "lambda of the next finer level"),
    Break("warpdef/fit/terms.py", "config.transform_weight / len(p.transitions)", "config.transform_weight",
          ("objective",), "a sum over frames for their mean"),
    Break("warpdef/fit/pairing.py", "c.agreement * share", "c.agreement", ("refine",),
          "noisy clouds lose pairs to their normals"),
    Break("warpdef/fit/pairing.py", "_BORDER_GAP = 0.9", "_BORDER_GAP = 0.0", ("refine_partial",),
          "an open mesh ends at its outermost points"),
    Break("warpdef/fit/unseen.py", "(times - times[near]) / (", "(times[far] - times) / (",
          ("unseen", "refine_partial"), "a frame is expected from the wrong side"),
    Break("kernels/unseen.py", "(share - 1.0) * half", "share * half", ("unseen",),
          "an arc is turned to another time"),
    Break("warpdef/fit/smoothness.py", "time_filter(p.times)", "time_filter(np.arange(frames))", ("smoothness",),
          "a gap in time is one step"),
    Break("warpdef/fit/smoothness.py", "<= reach]", "<= 99 * reach]", ("smoothness",),
          "a parabola reaches over long gaps"),
    Break("warpdef/fit/measures.py", "distance[:, 1].mean()", "distance[:, 2].mean()", ("refine",),
          "spacing to the second fellow"),
    Break("warpdef/fit/embedded.py", "scale = rigidity / max(len(self.link), 1)", "scale = rigidity", ("embedded",),
          "rigidity grows with the number of links"),
    Break("warpdef/fit/recover.py", "return 2.0 * keyframe_uncovered + least", "return least", ("recover",),
          "a sparse keyframe makes all frames lost"),
    # The fit that follows.
    Break("kernels/rigidity.py", "if scale > 0.0 and is_rotation(start):", "if scale > 0.0:", ("rigidity",),
          "rotations are followed from what is none"),
    Break("kernels/rigidity.py", "found = size < STILL_SQ", "found = True", ("rigidity",),
          "one step of Newton's method is taken for the end"),
    Break("warpdef/fit/problem.py", "chosen = [spread_evenly(c, most) for c in clouds]",
          "chosen = [np.arange(min(len(c), most)) for c in clouds]", ("problem", "objective_guide"),
          "grids are fitted to the first points, not to points evenly spread"),
    Break("warpdef/fit/terms.py", "return np.inf if p.config.optimiser.chain else _WHOLE", "return np.inf",
          ("refine", "refine_partial", "objective_guide"), "in complete frames no pair is weighed by the way back"),
    Break("warpdef/fit/terms.py", "_REACH_CLOUDS = 0.75", "_REACH_CLOUDS = 3.0", ("objective_guide",),
          "reach of the way back between clouds"),
    Break("warpdef/fit/follow.py", "zip(fitted[-2::-1], fitted[:0:-1], strict=True)", "zip([], [], strict=True)",
          ("follow", "follow_bends"), "no second try from the frame behind"),
    Break("warpdef/fit/follow.py", "if cost(frame) < least:", "if True:",
          ("follow", "follow_bends"),
          "what was bent is kept, better or not"),
    Break("warpdef/fit/follow.py", "if left < enough:", "if True:", ("follow_bends",),
          "what one camera saw is bent back, better or not"),
    Break("warpdef/fit/follow.py", "cost(frame) - GAIN)", "cost(frame))", ("sliding",), "any slide is kept"),
    Break("warpdef/fit/follow.py", "if config.recover and judged:", "if config.recover:",
          ("follow", "follow_bends"),
          "incomplete frames are judged lost and bent"),
    Break("warpdef/fit/follow.py", "objective.problem.normals.assign(walk.given)", "pass", ("follow",),
          "normals keep the sides of the way"),
    Break("warpdef/fit/follow.py", "self.objective.chain.move_one(s, 0, p.vertex_count)", "pass", ("follow",),
          "frames do not start from their neighbours"),
    Break("warpdef/fit/refine.py", "self.unseen.stay(frame)", "pass", ("follow", "refine_partial"),
          "what is not seen of a frame on the way is expected at zero"),
    Break("warpdef/fit/smoothness.py", "self.weight *= _STIFFENING**noise", "pass", ("smoothness",),
          "patches are as stiff in noise"),
    Break("kernels/patches.py", "smooth = -local[t, i]", "smooth = local[t, i]", ("patches",),
          "a vertex is driven from its smooth place"),
    Break("warpdef/fit/rest_shape.py", "_fair(self._fairings,", "_fair(0,", ("smoothness",),
          "a noisy shape is not faired"),
    Break("warpdef/fit/rest_shape.py", "self._fair(_BORDER_FAIRINGS,", "self._fair(0,", ("bending",),
          "the border of what one camera saw grows spikes"),
    Break("kernels/unseen.py", "trust_out[i] = seen_weight(pairs, i, pairs.frame[i])", "trust_out[i] = 1.0",
          ("unseen", "bending"), "every frame shapes what it does not show"),
    Break("kernels/rigidity.py", "w = trust[t, i] * trust[t, j]", "w = trust[t, i]", ("rigidity",),
          "an edge counts with one of its ends"),
    Break("warpdef/fit/transport.py", "u = np.minimum(1.0, capacity", "u = np.maximum(1.0, capacity", ("transport",),
          "a vertex has more than its own"),
    Break("warpdef/fit/bending.py", "begin is None or left <= max(FAULTLESS, usual)", "True", ("bending",),
          "fingers stay on the places of others"),
    Break("warpdef/fit/bending.py", "(held < _UNMET)", "(held < 0.0)", ("bending",),
          "what is hidden springs back to its rest"),
    Break("warpdef/geometry/viewpoint.py", "(beside > room) | (before > room)", "(beside > room)", ("viewpoint",),
          "what stands before all that was seen is taken for hidden"),
    Break("warpdef/quality/exposed.py", "facing & (coverage.away > FAR)", "coverage.away > np.inf", ("quality",),
          "an arm held up where the camera saw nothing is good"),
    Break("warpdef/quality/exposed.py", "(coverage.away > FAR) & ~steep", "coverage.away > np.inf", ("sheets_judged",),
          "a web across a gap that the camera saw through is good"),
    Break("warpdef/fit/limb_search.py", "- (1.0 + DOUBLE) * twice - cost", "- cost", ("limb_search",),
          "fingers are put where others are"),
    Break("warpdef/geometry/limbs.py", "for of in (peak[lower], peak[higher])", "for of in (peak[lower],)", ("limbs",),
          "the farthest finger of a hand is no limb"),
    Break("warpdef/quality/swollen.py", "most / growth**2 - 1.0", "most - growth", ("limbs",),
          "a body that grows as a whole has grown fingers"),
    Break("warpdef/quality/assess.py", "return min(coverage.noise, ", "return max(coverage.noise, ", ("quality",),
          "what a body bends between few points is noise"),
    Break("warpdef/quality/slippage.py", "0.5 * _BORDER * length", "0.0 * _BORDER * length", ("slippage",),
          "a flat sheet turns and shifts unseen in its plane"),
    Break("warpdef/quality/layers.py", "(within < SPLIT) & (gap", "(gap", ("sheets_judged",),
          "noise passes for two layers"),
    Break("warpdef/quality/overhang.py", "min(b / surface, g - most)", "b / surface", ("sheets_judged",),
          "what was not seen to its border counts as drawn out"),
    Break("warpdef/quality/overhang.py", "most = max(g for", "most = min(g for", ("sheets_judged",),
          "a sheet that stretches, and is not seen to its end, counts as drawn out"),
    Break("warpdef/fit/pairing.py", "share > _OPPOSED_MAX", "share > 1.0", ("refine",),
          "given sides are never doubted"),
    Break("warpdef/fit/unseen.py", "(complete[far] & (share > 0))", "complete[far]", ("refine_partial",),
          "a frame at an end is expected from a guess"),
    Break("warpdef/fit/rest_shape.py", "np.flatnonzero(p.measures.complete | ~p.measures.complete.any())",
          "np.arange(p.frame_count)", ("refine_partial",), "incomplete frames say what the shape is"),
    Break("warpdef/fit/optimise.py", "if problem.measures.complete[problem.transitions.keyframe] else 0.0", "",
          ("optimise",), "what a keyframe does not show of a template moves"),
    Break("warpdef/fit/recover.py", "if self.uncovered(neighbour) > _NOTHING:", "if False:", ("recover", "follow"),
          "bent from a mesh that lies on nothing"),
    Break("warpdef/fit/bending.py", "np.exp(-((back / (WAY_BACK", "np.exp(-0.0 * ((back / (WAY_BACK", ("bending",),
          "vertices ask back whatever their points ask for"),
    Break("warpdef/fit/bending.py", "agree = (facing[vertex] * cloud.normals[point]).sum(axis=1) > AGREEMENT",
          "agree = np.ones(len(away))", ("bending",), "points face the far side"),
    Break("warpdef/fit/run.py", "(r.config.recover or not self.optimiser.config.chain)", "r.config.recover",
          ("pipeline",), "without recovery nothing follows the grids"),
    # What has come since: mixtures, patches, neighbourhoods, orders, gaps, chains by halves, branches.
    Break("kernels/mixture.py", "total = float(_NOTHING)", "total = float(0.0)", ("mixture",),
          "a point that belongs to nothing asks for all of it"),
    Break("kernels/mixture.py", "rhs[i] = sums[1] * m", "rhs[i] = wp.vec3(sums[1])", ("mixture",),
          "noisy points pull along the surface"),
    Break("kernels/mixture.py", "limit = reach * reach", "limit = reach", ("mixture",),
          "vertices far beyond the noise are asked"),
    Break("kernels/patches.py", "shift_out[t, n] = at - turn * origin", "shift_out[t, n] = at - origin", ("patches",),
          "a patch is shifted as if it did not turn"),
    Break("kernels/patches.py", "weight = hold * (1.0 + firmer * even)", "weight = hold * (1.0 + firmer)", ("patches",),
          "what moves unevenly is held as firmly"),
    Break("kernels/nearby.py", "index > found[filled - 1]) continue", "index < found[filled - 1]) continue",
          ("nearby",), "of neighbours equally far the last is kept"),
    Break("kernels/nearby.py", "nearest[wanted - 1] < wall * wall) break",
          "nearest[wanted - 1] < 4.0f * wall * wall) break", ("nearby",),
          "a search ends before it has looked behind the wall"),
    Break("kernels/nearby.py", "if lengths[2] < lengths[least]:", "if lengths[2] > lengths[least]:", ("nearby",),
          "a plane along its normal"),
    Break("kernels/fairing.py", "factor * (mean / float(count) - moved)", "factor * (mean - moved)",
          ("patches", "bending"), "fairing towards the sum of neighbours"),
    Break("kernels/chains.py", "level_count, 3, x[0], x[1], x[2], moved)", "level_count, 3, x[0], x[1], x[2], r)",
          ("motion",), "a chain without its rotation"),
    Break("kernels/trilinear.py", "r[9 + k] += rise * along_z;", "r[9 + k] += rise * w;", ("trilinear_cuda", "motion"),
          "half a motion's derivative along z in cells, not in lengths"),
    Break("warpdef/fit/branches.py", "main.wait_event(end)", "pass", ("branches",),
          "what follows does not wait for the second branch"),
    Break("warpdef/fit/branches.py", "stream.wait_event(fork)", "pass", ("branches",),
          "a branch begins before what comes before it"),
    Break("warpdef/fit/bending.py", "if instead < (BETTER * left if begin is start else worth(left)):", "if True:",
          ("bending",), "shares are taken, better or not"),
    Break("warpdef/cleaning/order.py", "key=lambda b: (-(reach[b] + apart[t, b]), b)",
          "key=lambda b: (reach[b] + apart[t, b], b)", ("order",), "long branches of the walk first"),
    Break("warpdef/cleaning/order.py", " or turns(clouds):", ":", ("order",),
          "what turns fast is taken for scans in no order"),
    Break("warpdef/cleaning/shuffles.py", "if chance <= CHANCE or (", "if (", ("order",),
          "neighbours that are alike are believed by their medians alone"),
    Break("warpdef/cleaning/shuffles.py", "return _chance(_between(fields, shuffles)) <= CHANCE", "return False",
          ("order",), "motion that goes on tells no film"),
    Break("warpdef/motion/gaps.py", "strain(steady) <= max(_STRAINED * strain(turning), _STRAIN_LEAST)", "True",
          ("sequence",), "limbs that are too fast for a cubic are stretched by it"),
    Break("warpdef/motion/gaps.py", "leave = 2.0 * speed - arrive if", "leave = arrive if", ("sequence",),
          "at an end of the sequence a gap is left as it is arrived at"),
    Break("warpdef/motion/gaps.py", "len(missing) > _LONGEST or len(times) < 3", "len(times) < 3", ("sequence",),
          "speeds are believed over any gap"),
]
# fmt: on


def tests_pass(tree: Path, cache: Path, paths: list[str]) -> tuple[int, str]:
    """pytest's exit code for these files of a tree, -1 for no end; and the last line that names a test."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "WARP_CACHE_PATH": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n0", "--tb=no", "-p", "no:cacheprovider", *paths]
    try:
        ended = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=SECONDS_MAX, check=False
        )
    except subprocess.TimeoutExpired:
        return -1, "no end"
    said = [line for line in ended.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return ended.returncode, said[-1].split(" - ")[0] if said else ""


def outcome(entry: Break, tree: Path, cache: Path) -> tuple[str, str]:
    """What became of one break, and the test that saw it."""
    place = tree / entry.file
    whole = place.read_text()
    if whole.count(entry.old) != 1:
        return "stale", ""
    place.write_text(whole.replace(entry.old, entry.new))
    try:
        code, said = tests_pass(tree, cache, entry.paths)
    finally:
        place.write_text(whole)
    return {0: "survived", 1: "caught"}.get(code, "unclear"), said


def lay_out(folder: Path) -> tuple[Path, Path]:
    """A copy of the tree, and one of the kernels already compiled."""
    import warp as wp

    tree, cache = folder / "tree", folder / "cache"
    left = shutil.ignore_patterns(".git", "__pycache__", ".pytest_cache", ".ruff_cache", "build", "*.egg-info")
    shutil.copytree(ROOT, tree, symlinks=True, ignore=left)
    wp.config.log_level = logging.WARNING
    wp.init()
    compiled = Path(wp.config.kernel_cache_dir or cache)  # where it is, now that Warp has started
    if compiled.is_dir():
        shutil.copytree(compiled, cache)
    return tree, cache


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", type=int, nargs="+", metavar="N", help="these entries alone, counted from 1")
    chosen = parser.parse_args().only or range(1, len(BREAKS) + 1)
    if not all(1 <= n <= len(BREAKS) for n in chosen):
        parser.error(f"--only: expected numbers from 1 to {len(BREAKS)}")
    counts: dict[str, int] = {"caught": 0, "survived": 0, "unclear": 0, "stale": 0}
    with tempfile.TemporaryDirectory(prefix="break-core-") as folder:
        tree, cache = lay_out(Path(folder))
        paths = sorted({path for n in chosen for path in BREAKS[n - 1].paths})
        code, said = tests_pass(tree, cache, paths)
        if code:
            print(f"the tests do not pass before anything is broken: {said or f'exit code {code}'}")
            return 1
        for n in chosen:
            entry, began = BREAKS[n - 1], time.perf_counter()
            found, said = outcome(entry, tree, cache)
            counts[found] += 1
            seconds = time.perf_counter() - began
            print(f"{n:3} {found:9}{seconds:5.0f} s  {entry.file}: {entry.reason}  {said}", flush=True)
    print(", ".join(f"{count} {name}" for name, count in counts.items()))
    return 0 if counts["caught"] == len(chosen) else 1


if __name__ == "__main__":
    sys.exit(main())
