"""stub"""
SQLITE_MAGIC = b"SQLite format 3\0"
def read_sqlite(source, report, channels): yield from ()
