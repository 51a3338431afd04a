"""Ray clusters on this machine whose nodes can be killed."""

import contextlib
import os
import signal
from pathlib import Path

from small_runs import processes


def parents():
    """Return the id of each process's parent, by the process's id."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            found[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
    return found


@contextlib.contextmanager
def nodes(count, root, monkeypatch, env=None):
    """Start a cluster in which each node has one core and its own temporary folder.

    Yields the cluster's address and, by folder, functions that end a node as a loss of power would.
    env: environment variables of the nodes' processes.
    """
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_worker_niceness", "0")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})

    def add(folder):
        folder.mkdir(parents=True)
        node = cluster.add_node(num_cpus=1, env_vars={"TMPDIR": str(folder), **(env or {})})

        def lose():
            training = processes(folder)
            of_ray = [parent for child, parent in parents().items() if child in training]
            cluster.remove_node(node, allow_graceful=False)
            # Ray's own processes first, so that they cannot report that the training ended.
            for process in (*of_ray, *training):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)

        return lose

    try:
        lose = {folder: add(folder) for folder in (root / str(k) for k in range(count))}
        yield cluster.address, lose
    finally:
        cluster.shutdown()
