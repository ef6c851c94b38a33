#!/usr/bin/env bash
# Runs the processes of the learner's node: router, learner, evaluator, and, in a heterogeneous job, the actors' step.
#
# usage: learner.sh FOLDER (from learner.sbatch or hetjob.sbatch)
set -euo pipefail

folder=$1
# shellcheck source=/dev/null
source "$folder/launch.env"
# shellcheck source=common.sh
source "$LODESTONE_SLURM_HOME/common.sh"
forget_variables

job=${SLURM_JOB_ID:?this script runs in a job}
owner="job $job restart ${SLURM_RESTART_COUNT:-0} on ${SLURMD_NODENAME:-$(hostname)}"
run=$folder/run

# Why this job ends: `term` if Slurm sent SIGTERM to all its processes (requeued, canceled, preempted), `limit` if its
# time is almost up, `stop` if a user requested it, `fenced` if Slurm moved the run to another node.
stopping=
trap 'stopping=term' TERM INT
# Not SIGTERM, because Slurm sends that to every process of a job: the learner would already have received it, and a
# second one half a second later would end it before it has saved.
trap 'stopping=${stopping:-limit}' USR1

router=
learner=
evaluator=
actors=

# Prints the address at which other nodes reach this one: that of the requested interface, or the one that Slurm uses.
address() {
    local found
    if [[ -n ${LODESTONE_SLURM_INTERFACE:-} ]]; then
        found=$(ip -o -4 address show dev "$LODESTONE_SLURM_INTERFACE" | awk '{ sub("/.*", "", $4); print $4; exit }')
        [[ -n $found ]] || {
            say "$LODESTONE_SLURM_INTERFACE has no IPv4 address on this node: choose another --interface" >&2
            return 64
        }
    else
        found=$(scontrol show node "${SLURMD_NODENAME:-$(hostname)}" | sed -n 's/.*NodeAddr=\([^ ]*\).*/\1/p')
    fi
    printf '%s' "${found:-$(hostname -f)}"
}

is_healthy() {
    "$LODESTONE_SLURM_BINARY" healthcheck --file "$folder/health/$1" >/dev/null 2>&1
}

# Starts a router on a free port and publishes its endpoint.
start_router() {
    local host port code n first last
    local protocol=${LODESTONE_SLURM_PROTOCOL:-quic} ports=${LODESTONE_SLURM_PORTS:-20000-31999}
    first=${ports%-*} last=${ports#*-}
    # `set -e` has no effect in a function called with `||`, so each command handles its own failure.
    host=$(address) || return
    # The router's certificate must name the node that the job runs on.
    "$LODESTONE_SLURM_BINARY" keys router "$folder/keys" --host "$host" >/dev/null || return
    for ((n = 0; n < 20; n++)); do
        port=$((first + (RANDOM * 32768 + RANDOM) % (last - first + 1)))
        rm -f "$folder/health/router"
        "$LODESTONE_SLURM_BINARY" router --listen "$protocol/0.0.0.0:$port" --keys "$folder/keys" \
            --health-file "$folder/health/router" &
        router=$!
        while is_alive "$router" && ! is_healthy router; do
            [[ -z $stopping ]] || return 0
            nap 0.2
        done
        if is_alive "$router"; then
            printf '%s/%s:%s\n%s\n' "$protocol" "$host" "$port" "$owner" | write_whole "$folder/endpoint"
            local_endpoint=$protocol/127.0.0.1:$port
            say "router at $protocol/$host:$port"
            return 0
        fi
        code=0
        reap "$router" || code=$?
        router=
        # Retry only if the port was taken.
        ((code == 65)) || return "$code"
        ((first < last)) || break
    done
    say "no free port among $ports for the router" >&2
    return 65
}

# Checks by the learner's lock file that no other learner is using the run's folder. If the file cannot be locked for
# another reason, for example because the file system has no locks, the learner starts and says what is wrong.
is_free() {
    local code=0
    [[ -e $run/run.lock ]] || return 0
    flock --nonblock --conflict-exit-code 75 "$run/run.lock" true || code=$?
    ((code != 75))
}

start_learner() {
    "$LODESTONE_SLURM_BINARY" learner "${LODESTONE_SLURM_LEARNER[@]}" --run-dir "$run" --auto-resume \
        --connect "$local_endpoint" --keys "$folder/keys" --health-file "$folder/health/learner" &
    learner=$!
}

start_evaluator() {
    [[ -n $LODESTONE_SLURM_EVALUATOR && -e $run/config.toml ]] || return 0
    env -u CUDA_VISIBLE_DEVICES "$LODESTONE_SLURM_BINARY" evaluator --config "$run/config.toml" --device cpu --run-dir "$run" \
        --connect "$local_endpoint" --keys "$folder/keys" --health-file "$folder/health/evaluator" &
    evaluator=$!
}

# In a heterogeneous job, the actors are a step of the job.
start_actors() {
    [[ -n ${LODESTONE_SLURM_HETJOB:-} ]] || return 0
    srun --het-group=1 --ntasks="$LODESTONE_SLURM_ACTORS" --cpus-per-task="$LODESTONE_SLURM_ACTOR_CPUS" \
        --kill-on-bad-exit=0 --output="$folder/logs/actors-$job-%t.log" --open-mode=append \
        bash "$LODESTONE_SLURM_HOME/actor.sh" "$folder" &
    actors=$!
}

# Ends the remaining processes, the learner first because it has to save.
end_all() {
    if [[ -n $learner ]]; then
        [[ $stopping == term ]] || kill -TERM "$learner" 2>/dev/null || true
        reap "$learner" || say "the learner ended with $?"
        learner=
    fi
    for child in $evaluator $router; do
        end "$child" 15
    done
    evaluator=
    router=
}

# Checks whether the run has reached its steps.
is_finished() {
    local wanted saved
    wanted=$(sed -n 's/^n_env_steps *= *//p' "$run/config.toml" | tr -d _)
    saved=$(newest_step "$run")
    [[ -n $wanted && -n $saved ]] && ((saved >= wanted))
}

# Checks whether another node now serves the run, because Slurm lost contact with this one and restarted the job
# elsewhere. The job there waits until the learner here has saved and exited.
is_fenced() {
    local now
    now=$(owner_of "$folder")
    [[ -n $now && $now != "$owner" ]]
}

# Watches until a process exits or the job should end. Returns 0 if the learner has exited, with its exit code in
# `code`, and 1 otherwise.
watch_over() {
    local next_evaluator_s=0
    while [[ -z $stopping ]]; do
        nap 1
        if [[ -z $learner ]] && is_free; then
            start_learner
        elif [[ -n $learner ]] && ! is_alive "$learner"; then
            code=0
            reap "$learner" || code=$?
            learner=
            return 0
        elif ! is_alive "$router"; then
            say "the router ended"
            return 1
        elif [[ -e $folder/stop ]]; then
            stopping=${stopping:-stop}
        elif is_fenced; then
            stopping=${stopping:-fenced}
        elif ! is_alive "$evaluator" && ((SECONDS >= next_evaluator_s)); then
            start_evaluator
            [[ -z $evaluator ]] || next_evaluator_s=$((SECONDS + 30))
        fi
    done
    return 1
}

# Runs router, learner, and evaluator until the run is finished, cannot continue, or this job should end.
serve() {
    local code ended n_failures=0 began
    while [[ -z $stopping ]]; do
        began=$SECONDS
        code=0
        ended=router
        start_router || code=$?
        [[ -z $stopping ]] || break
        if ((code == 0)); then
            is_free || say "waits for the learner that holds $run/run.lock"
            ended=
            ! watch_over || ended=learner
        fi
        case $ended:$code in
        :*) ;;
        learner:0)
            if is_finished; then
                return 0
            fi
            say "somebody ended the learner before its steps were reached"
            ;;
        *:2 | *:64 | *:67 | *:71)
            say "the $ended cannot work: it ended with $code, and would again"
            return "$code"
            ;;
        *) say "the $ended ended with $code" ;;
        esac
        [[ -z $stopping ]] || break
        end_all
        ((SECONDS - began < 300)) || n_failures=0
        n_failures=$((n_failures + 1))
        if ((n_failures >= 12)); then
            say "gives up after $n_failures failures in a row"
            return 1
        fi
        nap "$((n_failures < 6 ? 5 * n_failures : 30))"
        if is_fenced; then
            stopping=${stopping:-fenced}
        fi
    done
    return 0
}

cancel_actors() {
    local ids
    ids=$(sed -n 's/^actors //p' "$folder/jobs" 2>/dev/null || true)
    # shellcheck disable=SC2086 # one word an id
    [[ -z $ids ]] || scancel $ids || true
}

if [[ -e $folder/stop ]]; then
    say "the run was stopped"
    exit 0
fi
say "$owner serves the run in $folder"
start_actors
failed=0
serve || failed=$?
end_all
[[ $(owner_of "$folder") != "$owner" ]] || rm -f "$folder/endpoint"
saved=$(newest_step "$run")

case $stopping in
'')
    if ((failed == 0)); then
        touch "$folder/finished"
        say "finished with ${saved:-0} steps"
    else
        say "failed with $failed; the newest checkpoint holds ${saved:-0} steps"
    fi
    cancel_actors
    ;;
limit)
    say "no time is left; saved at ${saved:-0} steps, back into the queue"
    scontrol requeue "$job"
    ;;
*) say "ended by ${stopping}; saved at ${saved:-0} steps" ;;
esac
if [[ -n $actors ]]; then
    # The actors' step exits on its own when the run is over or Slurm ends the job. SIGTERM to `srun` would kill them.
    deadline=$((SECONDS + (failed == 0 ? 60 : 0)))
    while is_alive "$actors" && ((SECONDS < deadline)); do
        nap 1
    done
    end "$actors" 10
fi
exit "$failed"
