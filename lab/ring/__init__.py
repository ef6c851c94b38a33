"""What the checks of whole rings share: processes, deadlines, the bus, run folders, and the report."""
