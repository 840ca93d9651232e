"""MoorDyn files: inputs (versions 1 and 2) to scenes and back, and result tables in MoorDyn's form.

    reader.read_moordyn     a file as plain values of a scene (`load_scene` and `dropper run` take MoorDyn files too)
    writer.write_moordyn    a scene as a MoorDyn v2 input
    outputs.write_out       a run as a table of MoorDyn's channels

Nothing is imported here: reading needs no JAX.
"""
