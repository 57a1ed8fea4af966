"""The static report of a run, `report.html`."""
