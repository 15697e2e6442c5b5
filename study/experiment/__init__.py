"""What a study is: an experiment's body and ground of a run, and an arm that proposes trials."""
