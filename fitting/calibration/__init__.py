"""From traces and a scene to a result: what comes before and after an estimate, and `fit`, which does all of it."""
