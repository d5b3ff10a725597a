"""CPU seconds of every file and room of tests, children included; what of it XLA compiled (`pytest --times`)."""

import os
from collections import defaultdict

import jax
import pytest

COMPILED = "/jax/core/compile/backend_compile_duration"
TOP = 15


def cpu_seconds() -> float:
    """User and system time of this process and of its children that have ended."""
    return sum(os.times()[:4])


class Times:
    """Attaches to every report what its phase took; adds them up where the reports end (the controller of xdist)."""

    def __init__(self):
        self.mark = cpu_seconds()
        self.compiled = [0, 0.0]  # programs, seconds
        self.tests = defaultdict(lambda: [0.0, 0, 0.0])
        jax.monitoring.register_event_duration_secs_listener(self._compiled)

    def _compiled(self, event, seconds, **_):
        if event == COMPILED:
            self.compiled[0] += 1
            self.compiled[1] += seconds

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item, call):
        report = yield
        now = cpu_seconds()
        report.spent = [now - self.mark, *self.compiled]
        self.mark, self.compiled = now, [0, 0.0]
        return report

    def pytest_runtest_logreport(self, report):
        for i, x in enumerate(getattr(report, "spent", ())):
            self.tests[report.nodeid][i] += x

    def pytest_terminal_summary(self, terminalreporter):
        show = terminalreporter.write_line
        for title, key in (("file", 0), ("room", 1)):
            sums = defaultdict(lambda: [0, 0.0, 0, 0.0])
            for name, spent in self.tests.items():
                path = name.split("::")[0]
                total = sums[path.rsplit("/", 1)[0] if key else path]
                for i, x in enumerate((1, *spent)):
                    total[i] += x
            show("")
            show(f"{title:44s}{'tests':>7s}{'CPU s':>9s}{'programs':>10s}{'compiling s':>13s}")
            for name, total in sorted(sums.items(), key=lambda x: -x[1][1]):
                show(f"{name:44s}{total[0]:7d}{total[1]:9.1f}{total[2]:10d}{total[3]:13.1f}")
        total = sum(spent[0] for spent in self.tests.values())
        show(f"{'all':44s}{len(self.tests):7d}{total:9.1f}")
        show("")
        for name, spent in sorted(self.tests.items(), key=lambda x: -x[1][0])[:TOP]:
            show(f"{spent[0]:7.1f} CPU s  {name}")
