defmodule Aerie.Config.PartsTest do
  @moduledoc "A key and its default stand in one place, and somebody reads it."
  use ExUnit.Case, async: true

  alias Aerie.Config
  alias Aerie.Config.Keys
  alias Aerie.Base.Settings.Schema

  @lib Path.expand("../../../../*/lib/**/*.ex", __DIR__)

  test "what a part has by default is what the configuration has by default" do
    # Left out, the address to listen on is a link: the only value that is not the part's own.
    config = Config.default([{"mavlink.local_addr", "off"}])
    config = put_in(config.mavlink.local_addr, nil)

    for part <- Keys.parts() do
      assert {:ok, settings} = part.new(%{})
      assert part.from(config) == settings
      assert part.from(%{}) == settings
      assert part |> struct() |> Map.from_struct() |> Map.values() |> Enum.all?(&is_nil/1), inspect(part)
    end
  end

  test "each key belongs to one part" do
    paths = for part <- Keys.parts(), setting <- part.settings(), not setting.internal, do: setting.path
    assert paths -- Enum.uniq(paths) == []
    assert Enum.sort(Enum.uniq(Enum.map(paths, &hd/1))) == Enum.sort(Keys.order())
  end

  test "a part refuses unknown keys with a suggestion, and values out of range with the range" do
    assert {:error, [problem]} = MavRouter.Recorder.Settings.new(%{recorder: %{max_fil_mb: 1}})
    assert %{path: ["recorder", "max_fil_mb"], hint: "did you mean \"max_file_mb\"?"} = problem
    assert {:error, [problem]} = MavRouter.Recorder.Settings.new(%{recorder: %{after_s: -1}})
    assert %{expected: "a number from 0 to 3600", got: "-1"} = problem
    assert {:ok, %{after_ms: 1500}} = MavRouter.Recorder.Settings.new(%{"recorder" => %{"after_s" => 1.5}})
  end

  # Words in the code, which finds what nobody reads any more; the declaration is one of the occurrences.
  test "every key is read by somebody" do
    uses =
      for file <- Path.wildcard(@lib),
          names <-
            Regex.scan(~r/[.:]([a-z]\w*)\b(?!:)|\b([a-z]\w*): /, File.read!(file), capture: :all_but_first),
          do: List.last(names)

    uses = Enum.frequencies(uses)

    named = for part <- Keys.parts(), setting <- part.settings(), do: {setting.name, setting.field}

    below = fn below, field ->
      case field.type do
        {:section, fields} -> Enum.flat_map(fields, &[&1.key | below.(below, &1)])
        {:list, {:section, fields}} -> Enum.flat_map(fields, &[&1.key | below.(below, &1)])
        _leaf -> []
      end
    end

    # MavRouter.Endpoints.Owner.Filter makes these names itself.
    filters = ~r/^(allow|block)_(messages|systems|components|sources)$/

    for {name, field} <- named,
        name <- [name | below.(below, field)],
        not (to_string(name) =~ filters),
        uniq: true do
      assert Map.get(uses, to_string(name), 0) > 1, "nothing reads #{name}"
    end
  end

  test "the leaves of the schema are the settings of the parts" do
    leaves = for {path, _field} <- Schema.leaves(Keys.fields()), do: Enum.join(path, ".")
    assert "recorder.ring.seconds" in leaves and "limits.max_vehicles" in leaves and "links" in leaves
    assert leaves == Enum.uniq(leaves)
  end
end
