"""A cluster of two nodes on this machine, each a process tree of its own; a line on stdin kills one of them.

It prints its address once both nodes are there, and ends with its stdin.
"""

from __future__ import annotations

import os
import sys

os.environ |= {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_worker_niceness": "0",
}

from ray.cluster_utils import Cluster

FEW = {"object_store_memory": 2**27, "include_dashboard": False}

if __name__ == "__main__":
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, **FEW})
    other = cluster.add_node(num_cpus=1, **FEW)
    cluster.wait_for_nodes()
    print(cluster.address, flush=True)
    for _ in sys.stdin:
        cluster.remove_node(other, allow_graceful=False)
        print("killed", flush=True)
    cluster.shutdown()
