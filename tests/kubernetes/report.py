"""What passed, what failed and why, and what could not be run."""

from collections.abc import Iterable


class Report:
    """Prints each judgment as it is made and counts them."""

    def __init__(self) -> None:
        self.n_passed = 0
        self.n_failed = 0

    def judge(self, what: str, complaints: Iterable[str]) -> None:
        """`what` holds if there are no complaints."""
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
        """Says that nothing is known about `what`."""
        print(f"not run {what}: {why}", flush=True)

    def close(self) -> int:
        """Prints the sums; the exit status."""
        print(f"{self.n_passed} passed, {self.n_failed} failed")
        return 1 if self.n_failed else 0
