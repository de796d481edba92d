"""Run time against error: measured cases, their floors, tables and plots."""
