"""Executors: run independent jobs on worker processes, such as trainings, evaluations and trials.

The interface follows `concurrent.futures`. `LocalExecutor` runs jobs on processes of this machine, and `RayExecutor` on
Ray, either on this machine or on a cluster. `make_executor` makes the executor that a command line selects.

    with LocalExecutor(max_workers=4) as executor:
        # Calls drive(environments, policy, group) for each group; results are in the order of `groups`.
        for episodes in executor.map(drive, groups, shared=(environments, policy)):
            ...
        # Calls train(config, seed, folder) for each job; results are in the order of completion.
        jobs = [Job(f"seed {seed}", (config, seed), folder / f"seed-{seed}") for seed in seeds]
        for job, summary in executor.as_completed(train, jobs, timeout=3600):
            ...

- **Workers stay alive between calls**, until `close`. Each worker has one thread and its own session, so that Ctrl-C
  reaches only the parent process. Workers end when the parent ends, even if it is killed.
- **Shared objects** are sent to each worker once, and again only after they have changed. Environments that open lazily
  therefore open once per worker; their pickle must exclude open resources.
- **Errors**: an `InputError` of a job is raised with the job's name, any other exception as a `RuntimeError` with its
  traceback. If a worker dies, its job is run again in an empty folder.
- **Leaving the loop early**, by an exception, Ctrl-C or `close` of the iterator, terminates the running jobs.

This room imports only `core` and no slow packages, because a worker must first limit the threads of such packages.
"""
