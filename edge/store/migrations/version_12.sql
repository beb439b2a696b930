-- What the second record of the counts has corrected (alarm `counts`), until a person acknowledges it.
CREATE TABLE corrected_counts (sentence TEXT NOT NULL) STRICT;
