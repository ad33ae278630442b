"""Train on a cluster of two nodes and lose one of them; run by ``test_cluster.py``."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from own_cluster import own_cluster


def main(folder: Path) -> None:
    cluster, (second,) = own_cluster(folder, 1, 1)
    import ray
    from test_cluster import trained

    from agents.training.cluster import ActorPool
    from agents.training.ray_session import ray_cluster
    from agents.training.rollout_worker import BatchSpec
    from envs.config import EnvConfig
    from questsim.motion.spec import load_motions

    clips = load_motions("synthetic:stand+wave")[:3]
    batch = BatchSpec(clips, EnvConfig(privileged=True, sampling="failure"), 4, seed=3)
    with ray_cluster(cluster.address, 2):
        print("nodes", sum(each["Alive"] for each in ray.nodes()), flush=True)
        pool = ActorPool(batch, 2)
        where = {str(ray.get(a.call.remote("node"))) for a in pool._actors}
        print("used", len(where), flush=True)
        expected = trained(pool)
        pool.close()
        pool = ActorPool(replace(batch), 2)

        def lose(done: int) -> None:
            if done == 1:
                cluster.remove_node(second, allow_graceful=False)
                cluster.add_node(num_cpus=1)
                print("lost", flush=True)

        found = trained(pool, after=lose)
        same = all((found[name] == expected[name]).all() for name in expected)
        print("same" if same else "different", flush=True)
        pool.close()
    cluster.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
