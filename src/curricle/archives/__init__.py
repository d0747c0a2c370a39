"""Files of arrays and JSON that carry their own checksums: whole or refused, without pickles."""
