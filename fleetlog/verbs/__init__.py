"""One file a verb: the function that ``import fleetlog`` offers and the command of the same name.

A module holds its function, a :class:`fleetlog.api.verb.Verb`, under the verb's name (``import_`` for
``import``, a word of Python); the first sentence of its docstring is the line in ``fleetlog --help``."""
