"""stub"""
MF4_MAGIC = (b"MDF     ", b"UnFinMF ")
def read_mf4(source, report, channels): yield from ()
