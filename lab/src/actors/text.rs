//! A report as text.

use std::fmt::{self, Write};

use super::report::{Report, Roles};
use super::usage::MemorySummary;

/// Renders the report, one topic per line.
pub(super) fn render(report: &Report) -> String {
    let mut text = String::new();
    for write in [write_pace, write_usage, write_weights, write_counts] {
        write(&mut text, report).expect("writing to a string cannot fail");
    }
    text
}

fn write_pace(out: &mut String, report: &Report) -> fmt::Result {
    let pace = if report.rate > 0.0 { format!("{} steps/s each", report.rate) } else { "full speed".to_owned() };
    let load = report.machine_load.map_or_else(|| "unknown".to_owned(), |load| format!("{load:.1}"));
    writeln!(
        out,
        "{} of {} actors, {pace}, {:.0} s, {} leaf routers; load of the machine {load}",
        report.n_actors, report.n_actors_asked, report.elapsed_s, report.n_leaves
    )?;
    writeln!(
        out,
        "acknowledged   {} segments, {} steps: {:.0} segments/s, {:.0} steps/s",
        report.n_segments, report.n_steps, report.segments_per_s, report.steps_per_s
    )?;
    let latency = report.ack_latency_ms;
    writeln!(out, "latency        p50 {:.1} ms, p99 {:.1} ms, max {:.0} ms", latency.p50, latency.p99, latency.max)?;
    let wire = report.loopback_bytes.map_or_else(String::new, |bytes| {
        format!(", {:.0} on the loopback interface with all else", bytes as f64 / (report.n_steps as f64).max(1.0))
    });
    writeln!(out, "bytes/step     {:.0} of payload{wire}", report.payload_bytes_per_step)
}

fn write_usage(out: &mut String, report: &Report) -> fmt::Result {
    let Roles { router, ingest, actors } = report.cpu_s_per_million_steps;
    writeln!(out, "CPU s/10⁶ steps router {router:.1}, ingest {ingest:.1}, actors {actors:.1}")?;
    let cores = |cpu_s: f64| cpu_s / report.elapsed_s;
    let Roles { router, ingest, actors } = report.cpu_s;
    writeln!(
        out,
        "cores used     router {:.2}, ingest {:.2}, actors {:.2}",
        cores(router),
        cores(ingest),
        cores(actors)
    )?;
    let Roles { router, ingest, actors } = &report.memory;
    for (name, memory) in [("router", router), ("ingest", ingest), ("actors", actors)] {
        if let Some(MemorySummary { first_mb, max_mb, last_mb, slope_mb_per_min }) = memory {
            writeln!(
                out,
                "memory         {name} {first_mb:.0} → {last_mb:.0} MB, at most {max_mb:.0}, {slope_mb_per_min:+.2} MB/min in the second half"
            )?;
        }
    }
    Ok(())
}

fn write_counts(out: &mut String, report: &Report) -> fmt::Result {
    let (counts, ingest) = (&report.counts, &report.ingest);
    writeln!(
        out,
        "refused        full {} at actors and {} at the ingest, stale {}, invalid {}",
        counts.full_total, ingest.ingest.full_total, counts.stale_total, counts.invalid_total
    )?;
    writeln!(
        out,
        "trouble        no answer {}, no learner {}, failed {}, in doubt {}, unsent {}, repeated {}",
        counts.no_reply_total,
        counts.no_learner_total,
        counts.failed_total,
        counts.in_doubt_total,
        counts.unsent_total,
        ingest.ingest.duplicates_total
    )?;
    if let Some(error) = &counts.first_error {
        writeln!(out, "first error    {error}")?;
    }
    let both = report.reconciled;
    writeln!(
        out,
        "both ends      acknowledged {}, accepted {}, lost {}, vanished {}, {}",
        both.acked,
        both.accepted,
        both.lost,
        both.vanished,
        match both.same_segments {
            Some(true) => "the same segments",
            Some(false) => "OTHER segments",
            None => "names not compared: some are in doubt",
        }
    )
}

fn write_weights(out: &mut String, report: &Report) -> fmt::Result {
    let weights = &report.weights;
    let n_failed = weights.pulls_failed_total;
    writeln!(
        out,
        "weights        {:.2} MB, {} publications, {n_failed} failed pulls",
        weights.parameter_bytes as f64 / 1e6,
        weights.deliveries.len()
    )?;
    let mut whole: Vec<_> = weights.deliveries.iter().filter(|delivery| delivery.n_missing == 0).collect();
    whole.sort_by(|a, b| a.max_s.total_cmp(&b.max_s));
    let (Some(best), Some(worst)) = (whole.first(), whole.last()) else { return Ok(()) };
    let middle = whole[whole.len() / 2];
    writeln!(
        out,
        "  all had them  in {} cases, after {:.2} s at best, {:.2} s in the median, {:.2} s at worst",
        whole.len(),
        best.max_s,
        middle.max_s,
        worst.max_s
    )?;
    writeln!(out, "  median case   p50 {:.2} s, p99 {:.2} s, max {:.2} s", middle.p50_s, middle.p99_s, middle.max_s)
}
