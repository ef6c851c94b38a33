# shellcheck shell=bash disable=SC2154 # the options are lodestone-slurm's
# `lodestone-slurm launch`: creates the keys and the jobs' settings, and submits the jobs.

launch() {
    find_binary
    # A run that computes on a GPU keeps doing so: its configuration says so, whatever this command line says.
    if [[ -z $gpu ]] && grep -qs '^device = "gpu"' "$folder/run/config.toml"; then
        gpu=1
        echo "the run's learner computes on a GPU, so its job asks for one"
    fi
    collect_sbatch_options
    refuse_if_active
    local learner_args=()
    [[ -z $preset ]] || learner_args+=(--preset "$preset")
    [[ -z $config ]] || learner_args+=(--config "$(readlink -f "$config")")
    [[ -z $run ]] || learner_args+=(--run "$run")
    [[ -z $seed ]] || learner_args+=(--seed "$seed")
    [[ -z $steps ]] || learner_args+=(--steps "$steps")
    [[ -z $gpu ]] || learner_args+=(--device gpu)
    # Catch a misspelled setting now rather than when the job starts. The router's address does not matter for that.
    "$binary" learner "${learner_args[@]}" --connect tcp/127.0.0.1:1 --print-config >/dev/null || die 64 "nothing was submitted"

    if [[ -e $folder/run/config.toml ]]; then
        echo "$folder holds a run: it continues with its own configuration, and with what the command line changes"
    else
        echo "a new run of ${config:-$preset} in $folder"
    fi
    [[ -n $hetjob ]] || respect_limit
    prepare
    if [[ -n $hetjob ]]; then submit_hetjob; else submit_jobs; fi
    [[ -n $dry_run ]] || cat <<TEXT
logs are in $folder/logs; these commands show and stop the run:
  $home/lodestone-slurm status --dir $(printf %q "$folder")
  $home/lodestone-slurm stop --dir $(printf %q "$folder")
TEXT
}

find_binary() {
    local candidates=("$home/../../target/release/lodestone" "$home/../../target/debug/lodestone") candidate
    candidates=("$(command -v lodestone || true)" "${candidates[@]}")
    [[ -z $binary ]] || candidates=("$binary")
    for candidate in "${candidates[@]}"; do
        if [[ -f $candidate && -x $candidate ]]; then
            binary=$(readlink -f "$candidate")
            return
        fi
    done
    die 64 "no program at ${candidates[*]}: build it with \`cargo build --release\` or name it with --binary PATH"
}

collect_sbatch_options() {
    learner_sbatch=("--cpus-per-task=$learner_cpus" "--signal=B:USR1@$save_lead_s" "${learner_sbatch[@]}")
    if [[ $actor_cpus == node ]]; then
        actor_sbatch=(--exclusive "${actor_sbatch[@]}")
    else
        actor_sbatch=("--cpus-per-task=$actor_cpus" "${actor_sbatch[@]}")
    fi
    [[ -z $gpu ]] || learner_sbatch=(--gres=gpu:1 "${learner_sbatch[@]}")
    [[ -z $learner_partition ]] || learner_sbatch=("--partition=$learner_partition" "${learner_sbatch[@]}")
    [[ -z $actor_partition ]] || actor_sbatch=("--partition=$actor_partition" "${actor_sbatch[@]}")
    [[ -z $time_limit ]] || learner_sbatch=("--time=$time_limit" "${learner_sbatch[@]}")
    actor_time=${actor_time:-$time_limit}
    [[ -z $actor_time ]] || actor_sbatch=("--time=$actor_time" "${actor_sbatch[@]}")
}

refuse_if_active() {
    command -v squeue >/dev/null || return 0
    local id states
    for id in $(ids_of learner) $(ids_of hetjob) $(ids_of actors); do
        states=$(states_of "$id")
        [[ -z $states ]] ||
            die 1 "$folder is trained by job $id already: see \`lodestone-slurm status --dir $folder\`, or stop it first"
    done
}

# Creates the folder, the keys, and the jobs' settings.
prepare() {
    act mkdir -p "$folder/logs" "$folder/health"
    if [[ ! -e $folder/keys/ca/cert.pem ]]; then
        # Hide its advice on distributing the keys. It does not apply here, where all processes read one shared folder.
        show "$binary" keys new "$folder/keys" --keep
        [[ -n $dry_run ]] || "$binary" keys new "$folder/keys" --keep >/dev/null
    fi
    act rm -f "$folder/stop" "$folder/finished" "$folder/endpoint"
    if [[ -n $dry_run ]]; then
        echo "+ write $folder/launch.env"
    else
        settings | write_whole "$folder/launch.env"
    fi
}

# shellcheck disable=SC2034 # `declare -p` prints them
settings() {
    local LODESTONE_SLURM_HOME=$home LODESTONE_SLURM_BINARY=$binary LODESTONE_SLURM_LEARNER=("${learner_args[@]}") \
        LODESTONE_SLURM_EVALUATOR=$evaluator LODESTONE_SLURM_INTERFACE=$interface LODESTONE_SLURM_ACTORS=$n_actors \
        LODESTONE_SLURM_ACTOR_CPUS=$actor_cpus LODESTONE_SLURM_PROTOCOL=$protocol LODESTONE_SLURM_PORTS=$ports
    echo "# What lodestone-slurm launch was told; the jobs of this run read it whenever they start."
    declare -p LODESTONE_SLURM_HOME LODESTONE_SLURM_BINARY LODESTONE_SLURM_LEARNER LODESTONE_SLURM_EVALUATOR \
        LODESTONE_SLURM_INTERFACE LODESTONE_SLURM_ACTORS LODESTONE_SLURM_ACTOR_CPUS LODESTONE_SLURM_PROTOCOL \
        LODESTONE_SLURM_PORTS
}

# Prints how many jobs this user may have in the queue, if Slurm says so: the most of all accounts, within what the
# cluster can hold. A tighter limit, such as that of a QOS, is for sbatch to name.
most_jobs() {
    {
        sacctmgr --noheader --parsable2 show assoc where "user=$(id -un)" format=MaxSubmitJobs |
            awk '$0 == "" { endless = 1 } $0 + 0 > most { most = $0 + 0 } END { if (!endless && most) print most }'
        scontrol show config | sed -n 's/^MaxJobCount *= *//p'
    } 2>/dev/null | sort -n | head -n 1 || true
}

# Leaves out the actors for which there is no room in the queue. Each task of an array counts as a job.
respect_limit() {
    local most queued room
    most=$(most_jobs)
    [[ $most =~ ^[0-9]+$ ]] || return 0
    queued=$(squeue --noheader --array --user="$(id -un)" --format=%i 2>/dev/null | wc -l)
    room=$((most - queued - 1))
    ((room < n_actors)) || return 0
    ((room > 0)) || die 1 "you may have $most jobs in the queue and have $queued: cancel some, or wait for them"
    echo "you may have $most jobs in the queue and have $queued: $room actors of $n_actors are submitted;" \
        "with --actor-cpus node, one fills a node"
    n_actors=$room
}

submit_jobs() {
    local first last ids=() id
    submit "$name-learner" "$folder/logs/learner-%j.log" "${learner_sbatch[@]}" "${both_sbatch[@]}" "$home/learner.sbatch"
    ids=("$submitted")
    [[ -n $dry_run ]] || echo "learner $submitted" | write_whole "$folder/jobs"
    # Clusters limit the array size, so a large number of actors is split into several arrays.
    local most
    most=$(scontrol show config 2>/dev/null | sed -n 's/^MaxArraySize *= *//p' || true)
    most=${most:-1001}
    for ((first = 0; first < n_actors; first += most)); do
        last=$((n_actors - first < most ? n_actors - first : most))
        if ! submit "$name-actors" "$folder/logs/actors-%A-%a.log" "--array=0-$((last - 1))" "${actor_sbatch[@]}" \
            "${both_sbatch[@]}" "$home/actors.sbatch"; then
            for id in "${ids[@]}"; do act scancel "$id"; done
            die 1 "the actors were not accepted, so the other jobs were cancelled"
        fi
        ids+=("$submitted")
        [[ -n $dry_run ]] || { cat "$folder/jobs" && echo "actors $submitted"; } | write_whole "$folder/jobs"
    done
    [[ -n $dry_run ]] || echo "submitted the learner as job ${ids[0]}, $n_actors actors as ${ids[*]:1}"
}

submit_hetjob() {
    submit "$name" "$folder/logs/learner-%j.log" "${learner_sbatch[@]}" "${both_sbatch[@]}" : \
        "--ntasks=$n_actors" "${actor_sbatch[@]}" "${both_sbatch[@]}" "$home/hetjob.sbatch"
    [[ -n $dry_run ]] || echo "hetjob $submitted" | write_whole "$folder/jobs"
    [[ -n $dry_run ]] || echo "submitted learner and $n_actors actors as job $submitted"
}

# Submits a job for the run's folder and stores its id in `submitted`.
submit() {
    local name=$1 log=$2 line
    shift 2
    line=(sbatch --parsable "--job-name=$name" "--output=$log" "$@" "$folder")
    submitted=
    show "${line[@]}"
    [[ -z $dry_run ]] || return 0
    submitted=$("${line[@]}") || return
    submitted=${submitted%%;*}
}
