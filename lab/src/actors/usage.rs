//! CPU time and memory of processes, as Linux reports them in /proc.

use std::fs;

use anyhow::Context;
use serde::Serialize;

/// Unit of CPU time in /proc, the same on every Linux.
const TICKS_PER_S: f64 = 100.0;

/// CPU time that a process has used so far, in seconds.
pub(super) fn cpu_s(pid: u32) -> anyhow::Result<f64> {
    let path = format!("/proc/{pid}/stat");
    let stat = fs::read_to_string(&path).with_context(|| format!("reading {path}"))?;
    ticks(&stat).map(|ticks| ticks as f64 / TICKS_PER_S).with_context(|| format!("{path} has no processor time"))
}

/// Resident memory of a process, in bytes.
pub(super) fn memory_bytes(pid: u32) -> anyhow::Result<u64> {
    let path = format!("/proc/{pid}/status");
    let status = fs::read_to_string(&path).with_context(|| format!("reading {path}"))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    kib.map(|kib| kib * 1024).with_context(|| format!("{path} has no memory"))
}

/// Bytes that the loopback interface of this network namespace has received, including headers.
pub(super) fn loopback_bytes() -> Option<u64> {
    let table = fs::read_to_string("/proc/net/dev").ok()?;
    let row = table.lines().find_map(|line| line.trim_start().strip_prefix("lo:"))?;
    row.split_whitespace().next()?.parse().ok()
}

/// The machine's 1-minute load average.
pub(super) fn machine_load() -> Option<f64> {
    fs::read_to_string("/proc/loadavg").ok()?.split_whitespace().next()?.parse().ok()
}

/// User plus system time from a line of /proc/PID/stat. The process name, which is in parentheses, may contain
/// anything.
fn ticks(stat: &str) -> Option<u64> {
    let (_, fields) = stat.rsplit_once(')')?;
    let mut fields = fields.split_whitespace().skip(11);
    let (user, system): (u64, u64) = (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
    Some(user + system)
}

/// Memory over time: seconds and bytes.
#[derive(Debug, Default)]
pub(super) struct MemoryCurve(Vec<(f64, u64)>);

/// Summary of a memory curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct MemorySummary {
    pub(super) first_mb: f64,
    pub(super) max_mb: f64,
    pub(super) last_mb: f64,
    /// Least-squares slope over the second half.
    pub(super) slope_mb_per_min: f64,
}

impl MemoryCurve {
    /// Adds the total memory of these processes at `time_s`.
    pub(super) fn sample(&mut self, time_s: f64, pids: &[u32]) -> anyhow::Result<()> {
        let held: Vec<u64> = pids.iter().map(|&pid| memory_bytes(pid)).collect::<anyhow::Result<_>>()?;
        if !held.is_empty() {
            self.0.push((time_s, held.iter().sum()));
        }
        Ok(())
    }

    pub(super) fn summary(&self) -> Option<MemorySummary> {
        let points: Vec<(f64, f64)> = self.0.iter().map(|&(time, bytes)| (time / 60.0, bytes as f64 / 1e6)).collect();
        let (first, last) = (points.first()?.1, points.last()?.1);
        let max_mb = points.iter().map(|point| point.1).fold(0.0, f64::max);
        let slope_mb_per_min = slope(&points[points.len() / 2..]);
        Some(MemorySummary { first_mb: first, max_mb, last_mb: last, slope_mb_per_min })
    }
}

/// Slope of the least-squares line; 0 for fewer than two points.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / n;
    let (mean_x, mean_y) = (mean(|p| p.0), mean(|p| p.1));
    let covariance: f64 = points.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    let variance: f64 = points.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
    if variance > 0.0 { covariance / variance } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_is_read_after_any_name() {
        let stat = "1234 (a) b (c) S 1 2 3 4 5 6 7 8 9 10 250 50 0 0 20";
        assert_eq!(ticks(stat), Some(300));
        assert_eq!(ticks("1234 (short) S 1"), None);
        assert!(cpu_s(std::process::id()).unwrap() >= 0.0 && memory_bytes(std::process::id()).unwrap() > 0);
    }

    #[test]
    fn the_slope_is_that_of_the_second_half() {
        // 100 MB per minute at first, then 2.
        let curve = [(0.0, 0), (60.0, 100), (120.0, 200), (180.0, 202), (240.0, 204), (300.0, 206)];
        let curve = MemoryCurve(curve.map(|(time, mb)| (time, mb * 1_000_000)).to_vec());
        let summary = curve.summary().unwrap();
        assert!((summary.slope_mb_per_min - 2.0).abs() < 1e-9, "{summary:?}");
        assert_eq!((summary.first_mb, summary.max_mb, summary.last_mb), (0.0, 206.0, 206.0));
        assert_eq!(MemoryCurve::default().summary(), None);
    }
}
