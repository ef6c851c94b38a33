//! Linear equations modulo 2, which decide which signs of magnets are compatible.

/// Maximum number of unknowns, each one bit of a mask.
const N_UNKNOWNS: usize = 64;

/// Consistent equations `sum of some unknowns = 0 or 1` modulo 2.
#[derive(Clone, Debug)]
pub(super) struct Parities {
    /// For each unknown, the equation in which it is the highest.
    rows: [Option<(u64, bool)>; N_UNKNOWNS],
}

impl Parities {
    pub(super) fn new() -> Self {
        Self { rows: [None; N_UNKNOWNS] }
    }

    /// Adds the equation that the unknowns in `mask` sum to `value`. Returns `false` and adds nothing if it contradicts
    /// the others.
    pub(super) fn add(&mut self, mask: u64, value: bool) -> bool {
        let (mask, value) = self.reduced(mask, value);
        // The highest of the unknowns.
        let Some(at) = mask.checked_ilog2() else { return !value };
        self.rows[at as usize] = Some((mask, value));
        true
    }

    /// Returns whether the equations determine the sum of the unknowns in `mask`.
    pub(super) fn determine(&self, mask: u64) -> bool {
        self.reduced(mask, false).0 == 0
    }

    /// Returns values that solve the equations, as a mask; free unknowns are 0.
    pub(super) fn solution(&self) -> u64 {
        // An equation's other unknowns are lower, so their values are already known.
        self.rows.iter().enumerate().fold(0, |solved, (at, row)| match row {
            Some((mask, value)) if *value != ((mask & solved).count_ones() % 2 == 1) => solved | 1 << at,
            _ => solved,
        })
    }

    /// Eliminates the unknowns that lead other equations, from the highest down.
    fn reduced(&self, mut mask: u64, mut value: bool) -> (u64, bool) {
        for at in (0..N_UNKNOWNS).rev() {
            if let Some((row, sum)) = self.rows[at].filter(|_| mask >> at & 1 == 1) {
                (mask, value) = (mask ^ row, value ^ sum);
            }
        }
        (mask, value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equations_are_solved_and_contradictions_refused() {
        let mut parities = Parities::new();
        // a + b = 1, b + c = 1, so a + c = 0.
        assert!(parities.add(0b011, true) && parities.add(0b110, true));
        assert!(parities.determine(0b101) && !parities.determine(0b001));
        assert!(!parities.add(0b101, true));
        assert!(parities.add(0b101, false));
        assert_eq!(parities.solution(), 0b010, "a is free and 0");
        assert!(parities.add(0b001, true));
        assert_eq!(parities.solution(), 0b101);
        assert!(parities.determine(0b010));
    }
}
