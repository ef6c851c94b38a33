"""Reports what passed, what failed and why, and what could not run."""

from collections.abc import Iterable


class Report:
    """Prints and counts the results of checks."""

    def __init__(self) -> None:
        self.n_passed = 0
        self.n_failed = 0

    def judge(self, what: str, complaints: Iterable[str]) -> None:
        """Reports `what` as passed if there are no complaints."""
        found = list(complaints)
        if found:
            self.n_failed += 1
            print(f"FAILED  {what}", flush=True)
            for complaint in found:
                print(f"        {complaint}", flush=True)
        else:
            self.n_passed += 1
            print(f"passed  {what}", flush=True)

    @staticmethod
    def skip(what: str, why: str) -> None:
        """Reports that `what` was not checked."""
        print(f"not run {what}: {why}", flush=True)

    def close(self) -> int:
        """Prints the totals and returns the exit status."""
        print(f"{self.n_passed} passed, {self.n_failed} failed")
        return 1 if self.n_failed else 0
