# shellcheck shell=bash
# Shared by the jobs of a run: names in the run's folder, and functions that wait for processes while handling signals.
#
# A run's folder is on a file system that all nodes share:
#   launch.env   options of `lodestone-slurm launch`, read by the jobs
#   jobs         ids of the submitted jobs, one line each: `learner ID`, `actors ID`, `hetjob ID`
#   keys/        the bus keys of each role, from `lodestone keys new`
#   endpoint     the router's current endpoint and the job that wrote it; replaced atomically
#   run/         the learner's and evaluator's run folder
#   health/      the files that `lodestone healthcheck` reads
#   logs/        output of the jobs
#   stop         exists when the run should save and end
#   finished     exists when the run's steps are reached

# Unsets the environment variables that `lodestone` reads like flags, whatever set them.
forget_variables() {
    unset LODESTONE_PRESET LODESTONE_CONFIG LODESTONE_RUN LODESTONE_RUN_DIR LODESTONE_SEED LODESTONE_STEPS \
        LODESTONE_CONNECT LODESTONE_LISTEN LODESTONE_ID LODESTONE_KEYS LODESTONE_AUTO_RESUME LODESTONE_HEALTH_FILE \
        LODESTONE_FAIL_UNFINISHED
}

say() {
    printf '%s %s\n' "$(date -u +%Y-%m-%dT%H:%M:%SZ)" "$*"
}

# Writes standard input to FILE atomically: a reader sees either the old text or the new.
write_whole() {
    local file=$1 part
    part="$file.part-$$-$RANDOM"
    cat >"$part"
    mv -f "$part" "$file"
}

# Prints the router's endpoint from FOLDER, or nothing.
endpoint_of() {
    local endpoint=''
    { read -r endpoint <"$1/endpoint"; } 2>/dev/null || true
    printf '%s' "$endpoint"
}

# Prints the owner of the endpoint in FOLDER, or nothing.
owner_of() {
    local owner=''
    { { read -r _ && read -r owner; } <"$1/endpoint"; } 2>/dev/null || true
    printf '%s' "$owner"
}

# Prints the environment steps of the newest checkpoint in RUN, or nothing.
newest_step() {
    local checkpoint newest=''
    for checkpoint in "$1"/checkpoints/step-*; do
        checkpoint=${checkpoint##*/step-}
        [[ $checkpoint =~ ^[0-9]+$ ]] && ((10#$checkpoint >= ${newest:-0})) && newest=$((10#$checkpoint))
    done
    printf '%s' "$newest"
}

is_alive() {
    [[ -n $1 ]] && kill -0 "$1" 2>/dev/null
}

# Sleeps for N seconds or until a signal arrives. Bash runs traps only between commands, but a signal interrupts `wait`.
nap() {
    local sleeper
    sleep "$1" &
    sleeper=$!
    wait "$sleeper" || true
    kill "$sleeper" 2>/dev/null || true
}

# Waits until the child PID has exited, regardless of signals. Returns its exit code.
reap() {
    local code
    while true; do
        code=0
        wait "$1" || code=$?
        # If a trap interrupted `wait`, the child is still running.
        is_alive "$1" || break
    done
    return "$code"
}

# Ends the child PID with SIGTERM, and with SIGKILL after N seconds.
end() {
    local pid=$1 limit_s=$2 began=$SECONDS
    kill -TERM "$pid" 2>/dev/null || true
    while is_alive "$pid" && ((SECONDS - began < limit_s)); do
        nap 0.2
    done
    kill -KILL "$pid" 2>/dev/null || true
    reap "$pid" || true
}
