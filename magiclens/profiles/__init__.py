"""What lenses are made of and what makes them: materials and machines as data files, and the models that check them."""
