"""Imported before JAX: a process of one thread on one processor, whose runs are one kernel each."""

import os

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = (
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000000 "  # runs as one kernel
    "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
