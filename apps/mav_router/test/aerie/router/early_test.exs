defmodule Aerie.Router.EarlyTest do
  use ExUnit.Case, async: true

  alias Aerie.Router.Early
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @second 1_000_000

  defp frame(message, at) do
    {[frame], _parser} = Parser.push(Parser.new(), MavCodec.encode(message, system: 1, component: 1), at)
    frame
  end

  defp text(n, at), do: frame(%M.Statustext{severity: 6, text: "#{n}"}, at)

  test "texts are given back in their order, once, nothing else is held" do
    beat = frame(%M.Heartbeat{type: 6, autopilot: 8}, 0)
    early = Enum.reduce([[text(1, 1), beat, text(2, 2)], [text(3, 3)]], Early.new(), &Early.hold(&2, :a, &1))
    assert {texts, left} = Early.take(early, :a, 4)
    assert Enum.map(texts, & &1.at) == [1, 2, 3]
    assert Early.take(left, :a, 4) == {[], Early.new()}
    assert Early.hold(Early.new(), :a, [beat]) == Early.new()
  end

  test "bounded in texts, systems and time" do
    flood = for n <- 1..1000, do: text(n, n)
    early = for system <- 1..1000, reduce: Early.new(), do: (early -> Early.hold(early, system, flood))
    assert map_size(early) == 32
    assert {texts, _} = Early.take(early, 1, 1000)
    assert Enum.map(texts, & &1.at) == Enum.to_list(1..16)

    # Others find room when the first ones are too old.
    later = Early.hold(early, :late, [text(1, 60 * @second)])
    assert Map.keys(later) == [:late]
    assert {[], _} = Early.take(early, 1, 60 * @second)
  end
end
