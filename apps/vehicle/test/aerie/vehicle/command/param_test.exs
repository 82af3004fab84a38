defmodule Aerie.Vehicle.Command.ParamTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command.Param

  test "values from outside become what the parameter is, or say what was expected" do
    altitude = Param.number(:altitude, "m", 0, 500, "Height.")
    assert Param.check(altitude, 20, "altitude") == {:ok, 20.0}
    assert Param.check(altitude, 501, "altitude") == {:error, "altitude", "a number from 0 to 500 (m)", 501}
    assert {:error, _, _, "20"} = Param.check(altitude, "20", "altitude")

    item = Param.integer(:item, nil, 0, 9, "Item.")
    assert Param.check(item, 3.0, "item") == {:ok, 3}

    for bad <- [3.5, 10, 1.0e300, -1],
        do: assert({:error, _, "an integer from 0 to 9", ^bad} = Param.check(item, bad, "item"))

    force = Param.boolean(:force, "Anyway.")
    assert Param.check(force, true, "force") == {:ok, true}
    assert {:error, _, "true or false", 1} = Param.check(force, 1, "force")
    only = %{force | values: [true]}
    assert Param.check(only, true, "force") == {:ok, true}
    assert {:error, _, "true", false} = Param.check(only, false, "force")

    mode = Param.choice(:mode, ["a", "b"], "One.")
    assert Param.check(mode, "b", "mode") == {:ok, "b"}
    assert {:error, _, "one of a, b", "c"} = Param.check(mode, "c", "mode")

    name = Param.text(:name, 4, "Name.")
    assert Param.check(name, "abcd", "name") == {:ok, "abcd"}

    for bad <- ["", "abcde", <<0>>, 5],
        do: assert({:error, _, "a text of 1 to 4 characters", ^bad} = Param.check(name, bad, "name"))
  end

  test "of a list the item that is wrong is named, and a long one is not read" do
    list = Param.list(:cells, Param.number(:cell, "V", 0, 5, "Cell."), 2, "Cells.")
    assert Param.check(list, [1, 2], "cells") == {:ok, [1.0, 2.0]}
    assert {:error, "cells[1]", "a number from 0 to 5 (V)", 6} = Param.check(list, [1, 6], "cells")
    assert {:error, "cells", expected, "more than 2 items"} = Param.check(list, [1, 2, 3], "cells")
    assert expected == "a list of 1 to 2 items, each a number from 0 to 5 (V)"
    assert {:error, "cells", _, []} = Param.check(list, [], "cells")
  end
end
