raise ImportError("the copy was imported")
