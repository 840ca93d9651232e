"""`dropper report`: engineering evaluation of saved runs; docs/report.md defines each number."""
