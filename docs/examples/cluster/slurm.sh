#!/bin/bash
#SBATCH --job-name=simval
#SBATCH --ntasks=64
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=1G
#SBATCH --time=04:00:00
# A sweep as one job of a batch system: sbatch slurm.sh SUITE RUN
# The scheduler, the driver and RUN are on the first node; a task is a worker.
# Give the same RUN again to go on with a job that ran out of time.
set -eu
suite=$1 run=$2
workers=${SLURM_NTASKS:-2} port=${PORT:-8786}
address="tcp://$(hostname):$port"
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

dask scheduler --port "$port" --no-dashboard &
scheduler=$!
srun --ntasks="$workers" dask worker "$address" --nthreads 1 --no-dashboard &
tasks=$!
trap 'kill $scheduler $tasks 2>/dev/null || true' EXIT

# it waits for a first worker; those that come later are used too
simval sweep "$suite" --out "$run" --scheduler "$address" --wait 300 --resume
simval gate "$run" --no-baseline
