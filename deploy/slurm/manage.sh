# shellcheck shell=bash disable=SC2154 # the options are lodestone-slurm's
# `lodestone-slurm status` and `stop`.

# Fails if no run was launched in the folder.
need_run() {
    [[ -e $folder/jobs ]] || die 1 "$folder holds no run that was launched: name it with --run or --dir"
}

status() {
    need_run
    # shellcheck source=/dev/null
    source "$folder/launch.env"
    echo "run in $folder"
    status_of_learner
    local id
    for id in $(ids_of actors); do
        printf '%-10s job %s: %s\n' actors "$id" "$(count_states "$id")"
    done
    status_of_training
}

status_of_learner() {
    local id why
    for id in $(ids_of learner) $(ids_of hetjob); do
        printf '%-10s job %s: %s\n' learner "$id" "$(count_states "$id")"
    done
    if [[ -e $folder/finished ]]; then
        printf '%-10s %s\n' finished 'its steps are reached'
        return
    fi
    [[ -e $folder/endpoint ]] || return 0
    printf '%-10s %s\n' router "$(endpoint_of "$folder")"
    if why=$("$LODESTONE_SLURM_BINARY" healthcheck --file "$folder/health/learner" 2>&1); then
        why='the learner is connected and works'
    fi
    printf '%-10s %s\n' health "${why#error: }"
}

# Prints a job's state counts, such as `3 RUNNING, 1 PENDING`, or `ended`; `unknown` if Slurm does not answer.
count_states() {
    local states counted
    if ! states=$(states_of "$1"); then
        printf 'unknown'
        return
    fi
    counted=$(grep . <<<"$states" | sort | uniq -c | awk '{ printf "%s%s %s", separator, $1, $2; separator = ", " }' || true)
    printf '%s' "${counted:-ended}"
}

status_of_training() {
    local wanted saved line
    wanted=$(sed -n 's/^n_env_steps *= *//p' "$folder/run/config.toml" 2>/dev/null || true)
    saved=$(newest_step "$folder/run")
    line=$(grep '"key":"learner"' "$folder/run/metrics.jsonl" 2>/dev/null | tail -n 1 || true)
    printf '%-10s %s of %s, %.0f a second\n' steps "$(number n_env_steps "$line")" "${wanted:-unknown}" \
        "$(number env_steps_per_s "$line")"
    printf '%-10s %s\n' saved "${saved:-nothing yet}"
    line=$(grep '"key":"eval/summary"' "$folder/run/metrics.jsonl" 2>/dev/null | tail -n 1 || true)
    [[ -z $line ]] || status_of_success "$line"
}

# Prints the success over all blueprints from a LINE of the evaluator, for greedy and sampled actions if evaluated.
status_of_success() {
    local way rest
    for way in greedy sampled; do
        rest=${1#*\""$way"\":}
        (($(number n_episodes "$rest") > 0)) || continue
        printf '%-10s %.1f%% of %d episodes, %s actions, after %d steps\n' success \
            "$(awk "BEGIN { print 100 * $(number rate "$rest") }")" "$(number n_episodes "$rest")" "$way" "$(number n_env_steps "$1")"
    done
}

# Prints the first number with the name KEY in a line of JSON, or 0.
number() {
    local pattern="\"$1\":([0-9.eE+-]+)"
    if [[ $2 =~ $pattern ]]; then printf '%s' "${BASH_REMATCH[1]}"; else printf 0; fi
}

stop() {
    need_run
    local learners actors states began=$SECONDS
    learners=$(ids_of learner)$(ids_of hetjob)
    actors=$(ids_of actors)
    # The learner's job checks for this file every second, wherever it runs and however often it was requeued.
    act touch "$folder/stop"
    [[ -n $dry_run ]] || echo "waits for the learner to save, job $learners"
    while [[ -z $dry_run ]]; do
        states=$(states_of "$learners")
        [[ -n $states ]] || break
        # No learner is running that could save anything more.
        [[ $states != PENDING* ]] || act scancel "$learners"
        ((SECONDS - began < wait_s)) || die 1 "job $learners has not ended in $wait_s s: see $folder/logs; \`scancel $learners\` ends it"
        sleep 1
    done
    # shellcheck disable=SC2086 # one word an id
    [[ -z $actors ]] || act scancel $actors
    [[ -z $dry_run ]] || return 0
    await_actors "$began"
    echo "stopped; the newest checkpoint holds $(newest_step "$folder/run" | grep . || echo 0) steps"
}

# Waits until Slurm has ended the canceled actors, because `launch` refuses to start while any is left. BEGAN is when
# `stop` began.
await_actors() {
    local id states
    for id in $(ids_of actors); do
        while true; do
            # Not part of a condition, which would take a failure for the end of the job.
            states=$(states_of "$id")
            [[ -n $states ]] || break
            ((SECONDS - $1 < wait_s)) ||
                die 1 "the run is saved and its actors are canceled, but job $id has not ended in $wait_s s: see \`squeue -j $id\`"
            sleep 1
        done
    done
}
