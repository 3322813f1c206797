"""Selection of the radio's models by the names in ``[radio]``, and path losses from measured files.

Import `registry` to create or check the models of a run; `table` and `grid` are loaded by name. The built-in
models are in `netsim.phy`, and so are the protocols (`netsim.phy.interfaces`) and what composes the models.
"""
