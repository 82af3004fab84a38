ExUnit.start(exclude: Aerie.Browser.excluded())
