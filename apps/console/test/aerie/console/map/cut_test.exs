defmodule Aerie.Console.Map.CutTest do
  use ExUnit.Case, async: true

  @tag :node
  test "rings and lines are cut to a box" do
    assert {"", 0} = Aerie.Browser.run(Path.expand("../../../js/cut.mjs", __DIR__), [])
  end

  @tag :node
  test "clusters, motion between updates, fading, and the colours of tags" do
    assert {"", 0} = Aerie.Browser.run(Path.expand("../../../js/symbols.mjs", __DIR__), [])
  end
end
