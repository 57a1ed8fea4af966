#!/usr/bin/env bash
# A sweep as a job array of Slurm: each task computes one shard, and a last job merges the shards.
#     job=$(sbatch --parsable --array=1-8 examples/search/slurm_array.sh sweep PLAN.yaml DIR)
#     sbatch --dependency=afterok:$job examples/search/slurm_array.sh merge DIR
# A task that was preempted continues where it ended, since `--resume` keeps the finished runs.
#SBATCH --cpus-per-task=8
#SBATCH --time=04:00:00
#SBATCH --requeue
set -euo pipefail

case "$1" in
sweep)
    task=$SLURM_ARRAY_TASK_ID
    neoworld sweep "$2" --out "$3/shard_$task" --shard "$task/$SLURM_ARRAY_TASK_COUNT" --resume
    ;;
merge)
    neoworld sweep merge "$2"/shard_* --out "$2/all" --overwrite
    ;;
esac
