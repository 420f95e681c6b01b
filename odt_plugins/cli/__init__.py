"""The command line ``odt-plugins``. Only here is anything printed.

`main` runs a command and returns its exit code: 0 done, 1 could not (one sentence on stderr says
why), 2 wrong use. The commands are functions of click: `optimize`, `batch`, `quality`, `script`
and `demo` in `cli.main`, `compare` in `cli.compare`, `mesh` in `cli.generate`. The flags of
`optimize` and `batch` are made of the fields of `Options`. `write_beside` writes a file beside
its place and renames the file when it is complete; `progress_bar` shows a bar on terminals only;
`warnings_told` shows the warnings of the package as one line each.

Source: https://click.palletsprojects.com.
"""
