"""One pool of worker processes for all independent work: seeds, evaluations, trials of a study, the zoo.

The interface follows `concurrent.futures`. An executor runs jobs on processes of this machine (`LocalExecutor`) or on
Ray, here or on a cluster (`RayExecutor`); a command line chooses one (`make_executor`).

    with LocalExecutor(max_workers=4) as executor:
        # In the order of `groups`, each by a call drive(environments, policy, group):
        for episodes in executor.map(drive, groups, shared=(environments, policy)):
            ...
        # In the order in which they end, each by a call train(config, seed, folder):
        jobs = [Job(f"seed {seed}", (config, seed), folder / f"seed-{seed}") for seed in seeds]
        for job, summary in executor.as_completed(train, jobs, timeout=3600):
            ...

- **Workers stay alive between calls**, until `close`. They start when they are first needed, with one thread each, and
  in a session of their own, so that Ctrl-C reaches only the process that started them. They end with that process,
  however it ends.
- **Shared objects** are sent once to each worker, which keeps an object as long as each call shares it unchanged.
  Environments that open lazily therefore open once in each process; what they hold open must not be part of their
  pickle. An object that has changed, such as a policy that goes on learning, is sent again.
- **Errors**: an `InputError` of a job is raised with its name, any other exception as a `RuntimeError` with its
  traceback. A job whose worker dies is run again, in an empty folder.
- **Leaving the loop early**, by an exception, Ctrl-C or `close` of the iterator, terminates the jobs that still run.
- The folder of a job on another machine is copied back, and user-written modules are sent along.

`executor.py` is the place to begin. This room imports `core` alone, and nothing slow, because a worker sets its number
of threads before that.
"""
