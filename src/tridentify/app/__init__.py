"""The workbench: a page in the browser on a server of this machine, and nothing from elsewhere.

`start` runs the server, `server` has its routes, `session` what it keeps, `workers` the processes
that read and estimate, `tasks` what these are asked. The page itself stands in ``page/``.
"""
