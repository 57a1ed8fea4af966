"""Write the table of docs/tasks.md."""

from neoworld_mjx.io.files import write_atomic

from .task_page import PAGE, page

write_atomic(PAGE, page(PAGE.read_text(encoding="utf-8")))
