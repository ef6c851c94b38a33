#!/usr/bin/env bash
# Runs one actor: waits for the learner's endpoint, reconnects when it moves, and exits when the run ends.
#
# usage: actor.sh FOLDER (from actors.sbatch, or as a task of hetjob.sbatch)
set -euo pipefail

folder=$1
# shellcheck source=/dev/null
source "$folder/launch.env"
# shellcheck source=common.sh
source "$LODESTONE_SLURM_HOME/common.sh"
forget_variables

# The batch step of a job with a GPU passes this variable on to tasks without one.
unset CUDA_VISIBLE_DEVICES

# Why this task ends: `term` if Slurm sent SIGTERM to all its processes, `limit` if its time is almost up.
stopping=
trap 'stopping=term' TERM INT
trap 'stopping=limit' USR1

# Prints an id that is unique among all actors connected at the same time. A requeued task gets a new id, because its
# old bus session may outlive it by some seconds if its node was lost.
actor_id() {
    local id
    if [[ -n ${SLURM_ARRAY_JOB_ID:-} ]]; then
        id="actor-$SLURM_ARRAY_JOB_ID-$SLURM_ARRAY_TASK_ID"
    else
        id="actor-${SLURM_JOB_ID:?this script runs in a job}-${SLURM_PROCID:-0}"
    fi
    ((${SLURM_RESTART_COUNT:-0} == 0)) || id+="-r$SLURM_RESTART_COUNT"
    printf '%s' "$id"
}

is_over() {
    [[ -n $stopping || -e $folder/finished || -e $folder/stop ]]
}

threads=$LODESTONE_SLURM_ACTOR_CPUS
# An actor has at most 64 threads.
[[ $threads != node ]] || threads=$((SLURM_CPUS_ON_NODE < 64 ? SLURM_CPUS_ON_NODE : 64))
id=$(actor_id)
poll_s=${LODESTONE_SLURM_POLL_S:-10}
config=$folder/run/config.toml
say "$id on ${SLURMD_NODENAME:-$(hostname)} waits for the learner's endpoint in $folder"

while ! is_over; do
    endpoint=$(endpoint_of "$folder")
    # The learner writes its full configuration, so the actors need no preset.
    if [[ -z $endpoint || ! -e $config ]]; then
        nap "$poll_s"
        continue
    fi
    say "$id connects to $endpoint"
    "$LODESTONE_SLURM_BINARY" actor --config "$config" --device cpu --connect "$endpoint" --keys "$folder/keys" --id "$id" \
        --set "actor.n_threads=$threads" &
    actor=$!
    while is_alive "$actor" && ! is_over && [[ $(endpoint_of "$folder") == "$endpoint" ]]; do
        nap "$poll_s"
    done
    if ! is_over && is_alive "$actor"; then
        # The router is gone, so the actor cannot deliver anything anymore.
        end "$actor" 3
        continue
    fi
    # On `term`, Slurm has sent SIGTERM to the actor too, and a second one would stop it before it is done.
    [[ $stopping == term ]] || kill -TERM "$actor" 2>/dev/null || true
    code=0
    reap "$actor" || code=$?
    case $code in
    0) ;;
    2 | 64 | 71)
        say "$id cannot work: the actor ended with $code, and would again"
        exit "$code"
        ;;
    *)
        is_over || say "$id: the actor ended with $code and starts again in $poll_s s"
        is_over || nap "$poll_s"
        ;;
    esac
done

if [[ $stopping == limit && -n ${SLURM_ARRAY_JOB_ID:-} ]]; then
    say "$id has no time left and goes back into the queue"
    scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
fi
say "$id ends"
