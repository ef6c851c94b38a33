# shellcheck shell=bash
# What the jobs of a run share: names in the run's folder, and how to wait for processes while signals come.
#
# A run's folder lies on a file system that every node sees:
#   launch.env   what `lodestone-slurm launch` was told, for the jobs to read
#   jobs         ids of the submitted jobs, one line each: `learner ID`, `actors ID`, `hetjob ID`
#   keys/        who may do what on the bus, from `lodestone keys new`
#   endpoint     where the router is now and who says so; appears and changes as a whole
#   run/         the learner's and evaluator's run folder
#   health/      what `lodestone healthcheck` reads
#   logs/        output of the jobs
#   stop         there when the run is to save and end
#   finished     there when the run's steps are reached

# Forgets variables that would change what the flags of `lodestone` say, wherever they come from.
forget_variables() {
    unset LODESTONE_PRESET LODESTONE_CONFIG LODESTONE_RUN LODESTONE_RUN_DIR LODESTONE_SEED LODESTONE_STEPS \
        LODESTONE_CONNECT LODESTONE_LISTEN LODESTONE_ID LODESTONE_KEYS LODESTONE_AUTO_RESUME LODESTONE_HEALTH_FILE
}

say() {
    printf '%s %s\n' "$(date -u +%Y-%m-%dT%H:%M:%SZ)" "$*"
}

# Writes standard input to FILE so that a reader sees the old text or the new.
write_whole() {
    local file=$1 part
    part="$file.part-$$-$RANDOM"
    cat >"$part"
    mv -f "$part" "$file"
}

# Endpoint of the router that FOLDER names, or nothing.
endpoint_of() {
    local endpoint=''
    { read -r endpoint <"$1/endpoint"; } 2>/dev/null || true
    printf '%s' "$endpoint"
}

# Who wrote the endpoint that FOLDER names, or nothing.
owner_of() {
    local owner=''
    { { read -r _ && read -r owner; } <"$1/endpoint"; } 2>/dev/null || true
    printf '%s' "$owner"
}

# Environment steps of the newest checkpoint in RUN, or nothing.
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

# Sleeps for N seconds, or until a signal comes: bash runs a trap only between commands, and `wait` is one that ends early.
nap() {
    local sleeper
    sleep "$1" &
    sleeper=$!
    wait "$sleeper" || true
    kill "$sleeper" 2>/dev/null || true
}

# Waits until the child PID has ended, whatever signals come meanwhile. Its exit code.
reap() {
    local code
    while true; do
        code=0
        wait "$1" || code=$?
        # `wait` ends early for a trap; then the child is still there.
        is_alive "$1" || break
    done
    return "$code"
}

# Ends the child PID: SIGTERM, and after N seconds SIGKILL.
end() {
    local pid=$1 limit_s=$2 began=$SECONDS
    kill -TERM "$pid" 2>/dev/null || true
    while is_alive "$pid" && ((SECONDS - began < limit_s)); do
        nap 0.2
    done
    kill -KILL "$pid" 2>/dev/null || true
    reap "$pid" || true
}
