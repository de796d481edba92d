"""`svrgs bench`: run time and numerical error of the native core, lower bounds of the run time, tables and
charts."""
