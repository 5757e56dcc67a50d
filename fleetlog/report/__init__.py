"""``fleetlog report``: one page about one dataset, or about two side by side."""

from fleetlog.report.report import Report, report

__all__ = ["Report", "report"]
