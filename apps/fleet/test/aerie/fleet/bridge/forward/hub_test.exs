defmodule Aerie.Fleet.Bridge.Forward.HubTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Forward.Hub

  test "an answer says that the hub is there, or why not" do
    assert Hub.answer(%{body: ~s({"type": "info"})}) == :there
    assert Hub.answer(%{body: ["{", "}"]}) == :there
    assert Hub.answer(%{status: "503", body: ""}) == {:away, "there is no connection to it"}
    assert Hub.answer(%{body: ~s({"error": {"description": "no account"}})}) == {:away, "no account"}

    for text <- ["", "[]", "x", <<0, 255>>],
        do: assert({:away, "it answers " <> _} = Hub.answer(%{body: text}))
  end

  test "reports a refusal until a connection has lasted for half a minute" do
    assert Hub.refusal(%{problem: "no", connected_at: nil}, 0) == "no"
    assert Hub.refusal(%{problem: "no", connected_at: 1_000}, 30_999) == "no"
    assert Hub.refusal(%{problem: "no", connected_at: 1_000}, 31_000) == nil
    assert Hub.refusal(%{}, 0) == nil
  end
end
