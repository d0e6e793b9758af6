"""The lens as it is made - printed, milled, or cut by a milling program - and what it shows then."""
