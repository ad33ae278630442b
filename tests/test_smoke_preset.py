"""The whole of training in little: it must be worth more than doing nothing."""

from __future__ import annotations

from dataclasses import replace

from agents.evaluation.follow import choose_clips, evaluation_sim, follow
from agents.evaluation.rollout import env_config
from agents.loading import load_agent
from agents.training.options import TrainArgs
from agents.training.train_policy import train
from questsim.motion.spec import load_motions


def test_smoke_training_beats_no_torque_and_random_torques(tmp_path):
    assert train(TrainArgs(tmp_path / "run", preset="smoke")) == 0
    clips = choose_clips(load_motions("synthetic"), 24)
    scores = {}
    for name in ("zero", "random", str(tmp_path / "run")):
        agent = load_agent(name)
        sim = evaluation_sim(clips, replace(env_config(agent), fixed_start=True))
        agent.bind(sim)
        scores[name] = follow(agent, sim, clips).score
    zero, random, trained = scores.values()
    assert trained > 1.8 * zero
    assert trained > 3.0 * random
