"""`dropper report`: what an engineer asks of saved runs; docs/report.md says what each number means."""
