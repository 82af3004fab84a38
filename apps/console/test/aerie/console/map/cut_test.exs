defmodule Aerie.Console.Map.CutTest do
  use ExUnit.Case, async: true

  @tag :node
  test "rings and lines are cut to a box" do
    assert {"", 0} = Aerie.Browser.run(Path.expand("../../../js/cut.mjs", __DIR__), [])
  end
end
