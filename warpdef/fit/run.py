"""Both stages of the fit, run so that nothing is lost.

Every few iterations the state is looked at. If it is finite it is remembered on the device and, now and then, written
to a checkpoint; if it is not, all goes back to what was remembered, and on at half the rate. A run told to stop ends
with what it has. All of that happens at fixed iterations, so a run taken up again ends with the bits of one unbroken.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from warpdef.errors import WarpdefError
from warpdef.files.checkpoint import understood
from warpdef.fit.follow import follow
from warpdef.fit.optimise import Optimiser
from warpdef.fit.refine import Refinement
from warpdef.fit.saving import Saved, Saver
from warpdef.kernels.finite import flag_not_finite
from warpdef.progress import Callback, Limits, Progress

LOOK_EVERY = 10  # iterations between two looks at the losses: a look waits for the device
UNDO_MAX = 20  # undone steps in a row after which lower rates will not help either
_ROUND_COST = 3.0  # of a round of the vertex stage in iterations, for planning; about 2 were measured


@dataclass(frozen=True)
class Fitted:
    """What comes out, apart from the device.

    vertices: cube units, (T', V, 3) float32, of the frames fitted. nodes: of the grids, as ``Optimiser.nodes``.
    steps: the loss curve. stopped: why the run ended before its time, or empty. digests: of the clouds, by frame.
    """

    vertices: np.ndarray
    nodes: np.ndarray
    steps: list[dict[str, float]]
    stopped: str
    digests: list[str]


class FitRun:
    """A run of the grid stage and, where there is one, of the vertex stage.

    steps: the loss curve, a record a look. warnings: what went wrong and how it went on.
    followed: frames fitted one after the other (``follow``). bent: those of them that matches found, not grids.
    starts: where each frame is expected to have the template, (T, V, 3) in its order; None where nothing is known.
    stopped: why the run ended before its time; empty if it did not.
    """

    def __init__(
        self,
        optimiser: Optimiser,
        refinement: Refinement | None,
        threads: int,
        limits: Limits,
        saver: Saver,
        tell: Callback,
        starts: np.ndarray | None = None,
    ) -> None:
        self.optimiser, self.refinement, self.threads = optimiser, refinement, threads
        self.limits, self.saver, self.tell, self._starts = limits, saver, tell, starts
        self.steps: list[dict[str, float]] = []
        self.warnings: list[str] = []
        self.followed: list[int] = []
        self.bent: list[int] = []
        self.stopped = ""
        self._undone = 0  # in a row
        self._refining = False
        self._began_at = 0

    # Grid stage.

    def descend(self) -> None:
        """All iterations of the grid stage, or those until it must stop; then the vertices of all frames."""
        if self._refining:
            return
        o = self.optimiser
        if not o.done:
            o.keep()
        self._began_at = o.done
        begun = self.limits.seconds
        self._save_if_due()
        while not o.ended and not self.stopped:
            o.iterate()
            if o.done % LOOK_EVERY == 0 or o.done == o.iterations:
                self._look()
                self._save_if_due()
            if not o.ended:
                self.stopped = self.stopped or self.limits.reason(self._vertex_seconds(begun))
        if self.stopped:
            self._save_and_end()
            if o.done % LOOK_EVERY:
                self._look()
        o.finish()
        o.rest()

    def _look(self) -> None:
        o = self.optimiser
        solves = replace(o.solves)
        losses = o.look()
        if not (math.isfinite(losses["total"]) and o.finite()):
            o.solves = solves
            self._undo(losses)
            return
        self._undone = 0
        self.steps.append({"iteration": o.done, **losses})
        o.keep()
        self.tell(Progress("optimise", o.done, o.iterations, losses))

    def _undo(self, losses: dict[str, float]) -> None:
        o = self.optimiser
        reached = o.done
        o.go_back()
        self._undone += 1
        if self._undone > UNDO_MAX:
            why = f"the optimisation left the finite numbers by iteration {reached}"
            if not o.done:
                raise WarpdefError(f"{why} (losses {losses}), at any rate; lower optimiser.rate")
            self.stopped = f"{why} at any rate; the state of iteration {o.done} was taken"
            return
        o.slow_down(0.5 * o.rate_scale)
        self._warn(
            f"iterations {o.done + 1} to {reached} left the finite numbers and were undone; "
            f"learning rates are now {o.rate_scale:g} of the configured ones",
        )

    def _vertex_seconds(self, begun: float) -> float:
        """What the vertex stage will take, by the iterations so far; at most a third of the limit."""
        done = self.optimiser.done - self._began_at
        if self.refinement is None or done <= 0 or self.limits.seconds_max is None:
            return 0.0
        rounds = _ROUND_COST * self.refinement.config.iterations
        return min(rounds * (self.limits.seconds - begun) / done, self.limits.seconds_max / 3)

    # Vertex stage.

    def refine(self) -> None:
        """All rounds of the vertex stage, or those until it must stop."""
        r = self.refinement
        if r is None:
            return
        reason = self.limits.reason()
        if not self._refining and not reason:
            if r.config.follow and (r.config.recover or not self.optimiser.config.chain):
                objective = self.optimiser.objective
                self.followed, self.bent = follow(objective, r, self.threads, self.limits.reason, self._starts)
                reason = self.limits.reason()
            if not reason:
                r.start()
                self._refining = True
        # No round follows one that is undone: vertices as they were before it, and their shape, are the result then.
        rest = wp.clone(r.state()["rest"])
        rounds = r.config.iterations
        flag = wp.zeros(1, dtype=wp.int32, device=r.objective.problem.device)
        while r.done < rounds and not reason:
            r.run_round()
            if not _finite(r.state(), flag):
                self._warn(
                    f"round {r.done} of the vertex stage left the finite numbers and was undone; the result is that of "
                    f"round {r.done - 1}. Raise refine.damping",
                )
                r.restore({**r.state(), "vertices": r.state()["earlier"], "rest": rest}, r.done - 1)
                break
            r.look()
            wp.copy(rest, r.state()["rest"])
            self.tell(Progress("refine", r.done, rounds))
            self._save_if_due()
            reason = self.limits.reason()
        if reason and r.done < rounds:
            self.stopped = self.stopped or reason
            self._save_and_end()

    def fitted(self) -> Fitted:
        """The end of the run."""
        o = self.optimiser
        placed = o.objective.placed_vertices()
        return Fitted(placed, o.nodes.numpy(), self.steps, self.stopped, self.saver.digests)

    # On disk.

    def keep(self) -> None:
        """Write the end of the run: what is done with its result is done again from there if it is cut short."""
        self._save_and_end()

    def _save_if_due(self) -> None:
        if self.saver.due():
            self._save()

    def _save_and_end(self) -> None:
        """What comes after a stop is not the way of an unbroken run: it must not be what a later run goes on from."""
        self._save()
        self.saver.end()

    def _save(self) -> None:
        o, r = self.optimiser, self.refinement
        facts: dict[str, Any] = {
            "iteration": int(o.kept()["iteration"][0]),
            "iterations": o.iterations,
            "rate_scale": o.rate_scale,
            "undone": self._undone,
            "rounds": r.done if r is not None and self._refining else None,
            "steps": self.steps,
            "warnings": self.warnings,
            "followed": self.followed,
            "bent": self.bent,
            "solves": [asdict(s.solves) for s in (o, r) if s is not None],
        }
        arrays = {f"grids.{name}": a for name, a in o.kept().items()}
        if r is not None and self._refining:
            arrays |= {f"refine.{name}": a.numpy() for name, a in r.state().items()}
        trouble = self.saver.save(facts, arrays)
        if trouble:
            self._warn(trouble)

    def restore(self, saved: Saved) -> None:
        """Go on from a checkpoint of a run on the same problem.

        Raises:
            InputError: its state is not one of this problem.
        """
        facts, o, r = saved.facts, self.optimiser, self.refinement
        self.steps, self._undone = list(facts["steps"]), facts["undone"]
        self.warnings = [*facts["warnings"], *saved.warnings()]
        self.followed, self.bent = list(facts["followed"]), list(facts["bent"])
        with understood(saved.path):
            o.restore(saved.part("grids"), facts["rate_scale"])
            if not 0 <= o.done <= o.iterations:
                raise ValueError(f"iteration {o.done} of {o.iterations}")
            stages = [stage for stage in (o, r) if stage is not None]
            for stage, solves in zip(stages, facts["solves"], strict=True):
                stage.solves = solves
            if facts["rounds"] is not None:
                if r is None or not 0 <= facts["rounds"] <= r.config.iterations:
                    raise ValueError(f"round {facts['rounds']}")
                state = saved.part("refine")
                if {n: a.shape for n, a in state.items()} != {n: a.numpy().shape for n, a in r.state().items()}:
                    raise ValueError("expected the state of the same problem")
                r.restore(state, facts["rounds"])
                self._refining = True

    def _warn(self, message: str) -> None:
        self.warnings.append(message)
        o, r = self.optimiser, self.refinement
        if r is not None and self._refining:
            self.tell(Progress("refine", r.done, r.config.iterations, message=message))
        else:
            self.tell(Progress("optimise", o.done, o.iterations, message=message))


def _finite(state: dict[str, wp.array], flag: wp.array) -> bool:
    """Whether all positions and directions in a state are finite; rotations follow from them."""
    flag.zero_()
    for array in state.values():
        if array.dtype is wp.vec3:
            flag_not_finite(array, flag)
    return not flag.numpy()[0]
