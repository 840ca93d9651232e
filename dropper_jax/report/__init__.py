"""`dropper report`, `dropper view`: saved runs as numbers, a page in 3D, VTK; docs/which-number.md defines them."""
