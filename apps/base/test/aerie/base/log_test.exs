defmodule Aerie.Base.LogTest do
  # The log's levels belong to the VM.
  use ExUnit.Case, async: false

  alias Aerie.Base.Log

  setup do
    before = Log.levels()
    format = Log.format()

    on_exit(fn ->
      for area <- Log.areas(), do: Log.reset(area)
      Log.set_level(before.level)
      Log.configure(%Log.Settings{level: before.level, format: format})
    end)
  end

  test "an area has a level of its own until it follows the others again" do
    assert "mav_router" in Log.areas()
    assert Log.set_level("mav_router", :error) == :ok
    # Of a part that is not there nothing can be set.
    assert %{"mav_router" => :error} = Log.levels().areas |> Map.put_new("mav_router", level_of_base())
    assert Log.reset("mav_router") == :ok
    assert Log.levels().areas == %{}
  end

  defp level_of_base, do: with([{_module, level}] <- Logger.get_module_level(Aerie.Base.Log), do: level)

  test "an unknown area is refused" do
    assert Log.set_level("nonsense", :debug) == {:error, :unknown_area}
    assert Log.reset("nonsense") == {:error, :unknown_area}
  end

  test "the settings say the format and the level of everything" do
    assert {:ok, settings} = Log.Settings.new(%{log: %{level: :warning, format: :json}})
    assert Log.configure(settings) == :ok
    assert Log.levels().level == :warning
    assert {:error, [%{path: ["log", "level"]}]} = Log.Settings.new(%{log: %{level: "loud"}})
    for level <- Log.level_names(), do: assert(Log.set_level(level) == :ok)
    assert Log.levels().level == :none
  end
end
