"""`dropper report`: engineering evaluation of saved runs; docs/which-number.md defines each number."""
