"""Short programs that show how the library is used; tests run them."""
