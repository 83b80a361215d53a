"""Which effect it is: fits, evidence, the contest of the library's entries, experiments that tell rivals apart."""
