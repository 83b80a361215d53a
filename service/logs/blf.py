"""stub"""
def read_blf(source, report, channels): yield from ()
