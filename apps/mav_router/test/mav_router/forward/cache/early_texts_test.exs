defmodule MavRouter.Forward.Cache.EarlyTextsTest do
  use ExUnit.Case, async: true

  alias MavRouter.Forward.Cache.EarlyTexts
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

    early =
      Enum.reduce(
        [[text(1, 1), beat, text(2, 2)], [text(3, 3)]],
        EarlyTexts.new(),
        &EarlyTexts.hold(&2, :a, &1)
      )

    assert {texts, left} = EarlyTexts.take(early, :a, 4)
    assert Enum.map(texts, & &1.at) == [1, 2, 3]
    assert EarlyTexts.take(left, :a, 4) == {[], EarlyTexts.new()}
    assert EarlyTexts.hold(EarlyTexts.new(), :a, [beat]) == EarlyTexts.new()
  end

  test "bounded in texts, systems and time" do
    flood = for n <- 1..1000, do: text(n, n)

    early =
      for system <- 1..1000, reduce: EarlyTexts.new(), do: (early -> EarlyTexts.hold(early, system, flood))

    assert map_size(early) == 32
    assert {texts, _} = EarlyTexts.take(early, 1, 1000)
    assert Enum.map(texts, & &1.at) == Enum.to_list(1..16)

    # Others find room when the first ones are too old.
    later = EarlyTexts.hold(early, :late, [text(1, 60 * @second)])
    assert Map.keys(later) == [:late]
    assert {[], _} = EarlyTexts.take(early, 1, 60 * @second)
  end
end
