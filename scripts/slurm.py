"""Run a recipe on a SLURM cluster: Dask workers as jobs, and `tacgen run` on this machine, such as a login node.

    python scripts/slurm.py recipes/batch.yaml -o /shared/out/batch --jobs 40 --queue short --walltime 04:00:00

All nodes must share the folder. The same command resumes a stopped run; other options, such as `--set quality=draft`,
are passed to `tacgen run`. Without Dask, use a job array:

    sbatch --array=0-39 --wrap 'tacgen run recipes/batch.yaml -o /shared/out/batch --shard $SLURM_ARRAY_TASK_ID/40'
"""

import argparse
import shlex
import subprocess
import sys

from dask_jobqueue import SLURMCluster


def word(text: str) -> str:
    """A value that the job script, a shell's, takes as one word."""
    if not text.isprintable():
        raise argparse.ArgumentTypeError("must be one line")
    return shlex.quote(text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipe")
    parser.add_argument("-o", "--out", required=True, help="a folder that all nodes see")
    parser.add_argument("--jobs", type=int, default=4, help="jobs at a time, each of --cores workers")
    parser.add_argument("--cores", type=int, default=1, help="workers in a job, a core each")
    parser.add_argument("--memory", type=word, default="4GB", help="of a job")
    parser.add_argument("--walltime", type=word, default="01:00:00")
    parser.add_argument("--queue", type=word, help="partition; your cluster's usual one if left out")
    parser.add_argument("--account", type=word)
    parser.add_argument("--interface", type=word, help="network that nodes and this machine share, such as ib0")
    parser.add_argument("--dry-run", action="store_true", help="print the job script and do nothing")
    args, more = parser.parse_known_args()
    cluster = SLURMCluster(
        cores=args.cores,
        processes=args.cores,
        memory=args.memory,
        walltime=args.walltime,
        queue=args.queue,
        account=args.account,
        interface=args.interface,
        python=shlex.quote(sys.executable),
    )
    if args.dry_run:
        print(cluster.job_script())
        return 0
    with cluster:
        cluster.scale(jobs=args.jobs)
        run = [sys.executable, "-m", "tacgen", "run", args.recipe, "-o", args.out, "--engine", "dask"]
        return subprocess.call([*run, "--scheduler", cluster.scheduler_address, *more])


if __name__ == "__main__":
    sys.exit(main())
