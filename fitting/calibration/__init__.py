"""From traces and a scene to a result: the steps before and after an estimate, and `fit`, which runs all of them."""
