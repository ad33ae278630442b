"""A training spread over workers: the same bits as without, and nothing lost with a worker."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from learners import QUICK, SMALL, nothing

from agents.kinematic.data import MotionBank
from agents.kinematic.fit import Fit
from agents.kinematic.registry import AGENTS
from agents.kinematic.team import RayTeam, SharedStage, part_of
from agents.policy.checkpoint import load_policy, load_resume
from agents.policy.networks import MIN_STD
from agents.run_folder import versions
from agents.training.make_ppo import make_ppo
from agents.training.peers import PeerLostError, join
from agents.training.presets import StageConfig
from agents.training.ray_session import check_versions, ray_cluster
from agents.training.rollout_worker import BatchSpec, RolloutWorker, weights_of
from agents.training.stage import Budget
from envs.config import EnvConfig
from questsim.cli import main
from questsim.errors import InputError
from questsim.motion.retarget_back import to_motion
from questsim.motion.spec import load_motions
from tests.helpers import swaying_clip

STEPS = 4
CONFIG = StageConfig(1.0, SMALL, replace(QUICK, rollout_steps=STEPS, minibatch=32, epochs=1))


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def batch() -> BatchSpec:
    clips = load_motions("synthetic:stand+wave")[:3]
    return BatchSpec(clips, EnvConfig(privileged=True, sampling="failure"), 4, seed=3)


@pytest.fixture(scope="module")
def cluster():
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed")
    with ray_cluster(None, 2):
        import ray

        yield ray


@pytest.fixture
def closed_after(cluster):
    """Close workers also when a test fails: their cores would be missing for ever."""
    opened: list[Any] = []

    def keep(workers: Any) -> Any:
        opened.append(workers)
        return workers

    yield keep
    for workers in opened:
        workers.close()


def trained(
    env, iterations: int = 3, after=lambda done: None, other_clips=None
) -> dict[str, np.ndarray]:
    ppo = make_ppo(CONFIG, CONFIG.learning, env, 3)  # type: ignore[arg-type]
    for done in range(iterations):
        if done == 1 and other_clips is not None:  # as --vary does
            env.change_clips(other_clips, 7)
            ppo.begin_anew()
        ppo.iterate(nothing, 0.0)
        after(done)
    return weights_of(ppo.policy)


def same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[k], other[k]) for k in one)


def test_a_worker_in_the_state_of_another_plays_the_same_rollout(batch):
    ppo = make_ppo(CONFIG, CONFIG.learning, batch.make(), 3)  # type: ignore[arg-type]
    weights = weights_of(ppo.policy)
    one, other = RolloutWorker(batch), RolloutWorker(replace(batch, seed=99))
    for worker in (one, other):
        worker.learn_policy(ppo.policy)
    first = one.play(weights, [], STEPS, 0.0)
    other.play(weights, [], STEPS, 0.0)
    other.set_state(first.state)
    second = [worker.play(weights, first.episodes, STEPS, 0.0) for worker in (one, other)]
    for name in second[0].arrays:
        assert np.array_equal(second[0].arrays[name], second[1].arrays[name])
    assert np.array_equal(second[0].rewards, second[1].rewards)


def test_the_sampler_of_a_worker_knows_the_falls_of_all(batch):
    worker, sampler = RolloutWorker(batch), batch.make().sim.sampler
    fall = (np.array([1]), np.array([0]), np.array([5]), np.array([True]))
    sampler.record(*fall)
    ppo = make_ppo(CONFIG, CONFIG.learning, batch.make(), 3)  # type: ignore[arg-type]
    worker.learn_policy(ppo.policy)
    worker.play(weights_of(ppo.policy), [fall], 1, 0.0)
    assert worker._sampler["clip_failure"][1] == sampler.clip_failure[1] > 0.5


def test_one_worker_gives_the_bits_of_none_also_with_new_clips_and_after_its_death(
    batch, cluster, closed_after
):
    from agents.training.cluster import ActorPool

    others = load_motions("synthetic:stand+wave")[3:5]  # fewer clips than before
    expected = trained(batch.make(), other_clips=others)
    pool = closed_after(ActorPool(batch, 1))

    def kill(done: int) -> None:  # the third rollout is played by another worker
        if done == 1:
            os.kill(cluster.get(pool._actors[0].call.remote("pid")), signal.SIGKILL)

    assert same(trained(pool, other_clips=others, after=kill), expected)


def test_workers_that_learn_together_lose_nothing_with_one_of_them(batch, cluster, closed_after):
    from agents.training.shared_update import LearningPool, make_shared_ppo

    pool, found = closed_after(LearningPool(batch, 2)), []
    assert list(pool.map(abs, [-1, -2, -3])) == [1, 2, 3]
    begin = pool.get_state()
    for death in (False, True):  # twice from the same state, with the same workers
        pool.set_state(begin)
        ppo = make_shared_ppo(CONFIG, CONFIG.learning, pool, 3)  # type: ignore[arg-type]
        for done in range(3):
            ppo.iterate(nothing, 0.0)
            if death and done == 1:
                os.kill(cluster.get(pool._actors[1].call.remote("pid")), signal.SIGKILL)
        found.append(weights_of(ppo.policy))
    assert ppo.policy.actor.norm.count == 3 * 4 * STEPS  # of both workers
    assert same(*found)


def test_workers_that_share_the_batches_of_a_system_lose_nothing_with_one(
    tmp_path, cluster, closed_after
):
    config = AGENTS["hmdposer"].presets["smoke"]
    part = part_of(config.stages["network"], 2)
    motions = [to_motion(swaying_clip(frames=90))]
    about = ("hmdposer", config.spec, "network", part, 4, 0, 1)
    team, found = closed_after(RayTeam(SharedStage(*about, motions, []), 2)), []
    for death in (False, True):
        torch.manual_seed(0)
        module = AGENTS["hmdposer"].build(config.spec)
        task = AGENTS["hmdposer"].task(module, "network", part, MotionBank(motions, part.window), 4)
        folder, save = tmp_path / str(death), lambda *_: None
        fit = Fit("network", module, task, part, folder, Budget(None, 4), save, {}, 0, team=team)
        team.sync(fit._descent)
        for step in range(4):
            fit._step(0.0)
            if death and step == 1:
                os.kill(cluster.get(team._actors[0].pid.remote()), signal.SIGKILL)
        found.append({name: value.numpy() for name, value in module.state_dict().items()})
    assert same(*found)


def test_a_worker_that_learns_alone_has_the_bits_of_a_training_without(batch):
    from agents.training.peers import packed, unpacked
    from agents.training.shared_update import LearningWorker

    ppo = make_ppo(CONFIG, CONFIG.learning, batch.make(), 3)  # type: ignore[arg-type]
    update, episodes = packed(ppo.update_state()), []
    worker = LearningWorker(batch)
    worker.learn_ppo(CONFIG, CONFIG.learning.minibatch, 1)
    for _ in range(3):
        learned = worker.learn(update, episodes, False, 0.0)
        update, episodes = learned.update, learned.played.episodes
    ppo.load_update_state(unpacked(update))
    assert same(weights_of(ppo.policy), trained(batch.make()))


def test_peers_average_like_one_worker_with_all_samples_and_notice_a_death(tmp_path):
    values = torch.randn(2, 50, generator=torch.Generator().manual_seed(0))
    found: list[Any] = [None, None]

    def work(rank: int) -> None:
        peers, spare = join((str(tmp_path / "peers"), 0), "127.0.0.1", rank, 2, 2)
        own = values[rank]
        parameter = torch.nn.Parameter(torch.zeros(50))
        parameter.grad = own.clone()
        peers.average_gradients([parameter])
        mean, std = spare.mean_and_std(own)
        found[rank] = parameter.grad, mean, std, torch.stack(peers.each(own))
        if rank == 0:
            with pytest.raises(PeerLostError):
                peers.mean(own)  # the other one has gone

    threads = [threading.Thread(target=work, args=(rank,)) for rank in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    for gradient, mean, std, each in found:
        torch.testing.assert_close(gradient, values.mean(0))
        torch.testing.assert_close(mean, values.mean())
        torch.testing.assert_close(std, values.std())
        assert torch.equal(each, values)
    assert torch.equal(found[0][0], found[1][0])


def test_gradients_of_workers_without_workers_or_ppo_are_refused(tmp_path, capsys):
    line = f"train --preset smoke --out {tmp_path / 'run'} --gradients workers"
    assert main(line.split()) == 2
    assert "--gradients workers: needs --workers; add --workers N" in capsys.readouterr().err
    assert main([*line.split(), "--workers", "2", "--stage", "student"]) == 2
    assert "none of the stages learns by PPO" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")
@pytest.mark.parametrize(
    ("script", "expected"),
    [
        # trains the same when it loses a node; Ray reports the lost node in between
        ("two_nodes.py", ["nodes 2", "used 2", "lost", "same"]),
        # without its head a training ends with one line and a checkpoint, and goes on on another
        ("head_lost.py", ["exit 2", "one line", "checkpoint", "resumed"]),
        # trainings of both kinds whose command is killed end with the bits of one in one piece
        ("killed.py", ["policy killed", "policy same", "system killed", "system same"]),
    ],
)
def test_a_cluster_of_its_own(tmp_path, script, expected):
    path = Path(__file__).with_name(script)
    root = str(path.parents[1])
    done = subprocess.run(
        [sys.executable, str(path), str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=600,
        env={k: v for k, v in os.environ.items() if not k.startswith("RAY_")}
        | {"PYTHONPATH": root},
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert [line for line in done.stdout.splitlines() if line in expected] == expected


def test_a_cluster_of_one_machine_stays_on_loopback(cluster):
    assert cluster.util.get_node_ip_address() == "127.0.0.1"


def test_a_batch_that_cannot_be_shared_out_is_refused(batch, cluster):
    from agents.training.cluster import ActorPool

    with pytest.raises(InputError, match="multiple of 3, as in --envs 6"):
        ActorPool(batch, 3)


def test_more_workers_than_cores_are_refused(batch, cluster):
    from agents.training.cluster import ActorPool

    with pytest.raises(InputError, match="need 4 cores, the cluster has 2"):
        ActorPool(batch, 4)


def test_workers_that_need_more_memory_than_there_is_are_refused(batch, cluster):
    from agents.training.cluster import ActorPool

    with pytest.raises(InputError, match=r"2 workers of about 500\.5 GB each do not fit: .*room"):
        ActorPool(replace(batch, num_envs=2_000_000), 2)


def test_train_py_trains_with_workers_and_goes_on_with_others(tmp_path, cluster, capsys):
    out = tmp_path / "run"
    line = (
        f"train --preset smoke --stage teacher --motions synthetic:stand --envs 4 --threads 1"
        f" --out {out} --set stages.teacher.learning.rollout_steps=4"
        " stages.teacher.learning.minibatch=16 validation_clips=1"
    )
    shared = ["--gradients", "workers"]
    assert main([*line.split(), "--steps", "32", "--workers", "2", *shared]) == 0
    assert "gradients of 2 workers with 8 samples each: 16 a step" in capsys.readouterr().out
    longer = [*line.split(), "--steps", "64", "--workers", "2", *shared]
    assert main([*longer, "--resume"]) == 0
    assert "new episodes begin" not in capsys.readouterr().out
    assert main([word.replace(str(out), str(tmp_path / "whole")) for word in longer]) == 0
    whole, parts = (
        load_resume(folder / "teacher" / "last")["learner"]["policy"]
        for folder in (tmp_path / "whole", out)
    )
    assert all(torch.equal(value, parts[name]) for name, value in whole.items())
    capsys.readouterr()
    assert main([*line.split(), "--steps", "96", "--resume"]) == 0
    assert "another number of workers: new episodes begin" in capsys.readouterr().out


def test_workers_that_learn_keep_the_statistics_of_the_policy_they_start_from(tmp_path, cluster):
    line = (
        "train --preset smoke --stage teacher --envs 4 --threads 1 --steps 32"
        " --workers 2 --gradients workers --set stages.teacher.learning.rollout_steps=4"
        " stages.teacher.learning.minibatch=16 stages.teacher.learning.critic_warmup_steps=0"
        " validation_clips=1"
    )
    first, second = tmp_path / "first", tmp_path / "second"
    assert main([*line.split(), "--motions", "synthetic:stand", "--out", str(first)]) == 0
    start = ["--start", str(first), "--motions", "synthetic:jog", "--out", str(second)]
    assert main([*line.split(), *start]) == 0
    old, new = (load_policy(folder / "teacher" / "last").policy.actor for folder in (first, second))
    varied = old.norm.var.sqrt() > MIN_STD
    assert 100 < varied.sum() < len(varied)
    assert torch.equal(new.norm.mean[varied], old.norm.mean[varied])
    assert not torch.equal(new.norm.mean[~varied], old.norm.mean[~varied])
    weights = [next(actor.layers.parameters()) for actor in (old, new)]
    assert not torch.equal(*weights)


@pytest.fixture
def not_yet_connected(monkeypatch):
    ray = pytest.importorskip("ray", reason="Ray is not installed")
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr("agents.training.watched._watched", True)  # in this process
    monkeypatch.setenv("RAY_AUTH_MODE", "token")  # else it would stay set for other tests
    return ray


@pytest.mark.parametrize(
    "line",
    [
        "train --preset smoke --workers 1",
        "train --agent hmdposer --preset smoke --workers 2",
        "sweep --preset smoke",
        "motions vary synthetic:stand --count 1 --workers 1",
    ],
)
def test_a_cluster_that_does_not_answer_is_refused(tmp_path, not_yet_connected, capsys, line):
    out = tmp_path / "out.npz"
    assert main([*line.split(), "--ray", "127.0.0.1:1", "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert "error: --ray 127.0.0.1:1: no Ray cluster answers there: [Errno 111]" in error
    assert not out.exists()


@pytest.mark.parametrize("address", ["auto", "local", "head", "ray://head:10001", "[::1]:x", ":1"])
def test_what_is_no_address_of_a_cluster_is_refused(not_yet_connected, address):
    with pytest.raises(InputError, match="is not an address HOST:PORT"), ray_cluster(address, 1):
        pass


def test_a_cluster_of_another_version_is_named_in_one_line(not_yet_connected, monkeypatch):
    def refuse(**_: object) -> None:
        raise RuntimeError("Version mismatch: The cluster was started with:\n    Ray: 1.2\n")

    monkeypatch.setattr(not_yet_connected, "init", refuse)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(InputError, match=r"started with: Ray: 1\.2"), ray_cluster(address, 1):
            pass


def test_ray_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"needs Ray.*questsim\[cluster\]"), ray_cluster(None, 1):
        pass


@pytest.mark.parametrize(("name", "other"), [("mujoco", "1.0"), ("processor", "VSX")])
def test_a_worker_with_other_versions_is_refused(name, other):
    with pytest.raises(InputError, match=f"worker 1: has {name} {other}, the command has"):
        check_versions(versions() | {name: other}, versions(), "worker 1")


def test_a_replaced_worker_with_other_versions_is_refused(
    batch, cluster, closed_after, monkeypatch
):
    from agents.training.cluster import ActorPool

    pool = closed_after(ActorPool(batch, 1))
    ppo = make_ppo(CONFIG, CONFIG.learning, pool, 3)  # type: ignore[arg-type]
    ppo.iterate(nothing, 0.0)
    monkeypatch.setattr("agents.training.cluster.versions", lambda: versions() | {"torch": "0"})
    ppo.iterate(nothing, 0.0)  # those of the worker were checked when it began
    os.kill(cluster.get(pool._actors[0].call.remote("pid")), signal.SIGKILL)
    with pytest.raises(InputError, match="worker 0: has torch"):
        ppo.iterate(nothing, 0.0)


def test_a_cluster_without_workers_is_refused(tmp_path, capsys):
    line = f"train --preset smoke --out {tmp_path / 'run'} --ray localhost:6379"
    assert main(line.split()) == 2
    assert "--ray: needs --workers; add --workers N" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_the_cluster_file_of_the_docs_fits_rays_schema():
    ray = pytest.importorskip("ray", reason="Ray is not installed")
    jsonschema = pytest.importorskip("jsonschema")
    file = Path(__file__).parents[1] / "docs" / "examples" / "ray-cluster.yaml"
    schema = Path(ray.__file__).parent / "autoscaler" / "ray-schema.json"
    described = yaml.safe_load(file.read_text())
    jsonschema.validate(described, json.loads(schema.read_text()))
    assert described["head_node_type"] in described["available_node_types"]
    subprocess.run(["bash", "-n", str(file.with_name("cluster.slurm"))], check=True)
