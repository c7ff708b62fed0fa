"""Random search of a linear policy that turns a camera after a ball, from counts of events alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

import evis
from evis.gym import EventVectorEnv, Transition
from evis.motion import Placement

ENVIRONMENTS, STEPS, CANDIDATES = 8, 25, 16


class KeepInView:
    """A ball flies to either side; the action turns the camera, by at most 60 degrees per second."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, count: int) -> None:
        self.x, self.speed, self.yaw = np.zeros(count), np.zeros(count), np.zeros(count)

    def poses(self, ids: Any) -> dict[str, Any]:
        """Return where ball and camera are."""
        still = np.zeros((len(ids), 7))
        still[:, 6] = 1.0
        ball, eye = still.copy(), still
        ball[:, 0] = self.x[ids]
        eye[:, 2], eye[:, 4], eye[:, 6] = 3.0, np.sin(self.yaw[ids] / 2), np.cos(self.yaw[ids] / 2)
        return {"ball": ball, "eye": eye}

    def reset(self, ids: Any, rngs: Sequence[np.random.Generator]) -> dict[str, Any]:
        """Begin episodes: each ball gets its speed."""
        self.x[ids], self.yaw[ids] = 0.0, 0.0
        self.speed[ids] = [rng.choice([-1, 1]) * rng.uniform(4.0, 6.0) for rng in rngs]
        return self.poses(ids)

    def step(self, ids: Any, actions: Any) -> Transition:
        """Move balls and cameras; an episode ends where the ball is lost."""
        self.x[ids] += 0.01 * self.speed[ids]
        self.yaw[ids] -= 0.01 * np.radians(60.0) * np.clip(actions[:, 0], -1.0, 1.0)
        off = np.abs(np.arctan2(self.x[ids], 3.0) + self.yaw[ids])
        return Transition(self.poses(ids), np.cos(off), off > np.radians(16.0))


builder = evis.SceneBuilder("keep", duration=1.0, ambient=(1.0, 1.0, 1.0))
builder.texture("checker", pattern="checker")
builder.material("painted", texture="checker")
builder.sphere("ball", radius=0.3, material="painted")
eye = Placement(position=(0, 0, 3))
builder.camera(evis.EventCamera(name="eye", width=24, height=18, pose=eye))
for _ in range(ENVIRONMENTS):
    builder.environments(1)
sim = evis.Simulator(
    builder.build(), rate_hz=200.0, samples=1, poses=["ball", "eye"], reference_luminance=1.0
)
env = EventVectorEnv(sim, KeepInView(ENVIRONMENTS), autoreset_mode="NextStep", max_steps=STEPS)


def episodes(weights: Any) -> tuple[float, int]:
    """Return the mean number of steps in view, and the events seen."""
    observations, _ = env.reset(seed=1)
    alive, steps, events = np.ones(ENVIRONMENTS, bool), np.zeros(ENVIRONMENTS), 0
    memory = np.zeros(ENVIRONMENTS)
    for _ in range(STEPS):
        columns = observations.sum(axis=(1, 2))
        where = (columns * np.linspace(-1, 1, columns.shape[1])).sum(axis=1) / np.maximum(
            columns.sum(axis=1), 1
        )
        memory = 0.8 * memory + where
        actions = (weights[0] * where + weights[1] * memory)[:, None]
        observations, _, terminated, truncated, info = env.step(actions)
        steps += alive
        alive &= ~(terminated | truncated)
        events += sum(map(len, info["events"]))
    return float(steps.mean()), events


rng = np.random.default_rng(0)
best = np.zeros(2)
score, events = episodes(best)
print(f"a camera at rest: in view for {score:.1f} of {STEPS} steps, {events} events")
for candidate in range(CANDIDATES):
    weights = best + rng.normal(scale=3.0, size=2)
    found, events = episodes(weights)
    if found > score:
        best, score = weights, found
        print(
            f"candidate {candidate}: in view for {score:.1f} steps, weights {best.round(1)}, {events} events"
        )
