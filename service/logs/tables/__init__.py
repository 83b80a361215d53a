"""Tables of values with a time column (CSV, Parquet, data channels of MF4), with or without a CAN log beside."""
