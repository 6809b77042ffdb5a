"""Generated message modules: ``cloud_pb2`` (dialect A, the contract), ``io_pb2`` (dialect B), ``recording_pb2``.

The sources are the ``.proto`` files in ``proto/``; ``python proto/generate.py`` rewrites the modules. Import the modules,
not names from them: both dialects have a ``VelocityCommand`` and an ``EdgeEvent``.
"""
