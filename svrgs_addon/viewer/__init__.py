"""The interactive picture of `svrgs view`."""
