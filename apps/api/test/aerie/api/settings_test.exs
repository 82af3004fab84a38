defmodule Aerie.Api.SettingsTest do
  use ExUnit.Case, async: true

  @docs Path.expand("../../../../../docs/console.md", __DIR__)

  test "docs/console.md has every key of the console" do
    {:section, fields} = Enum.find(Aerie.Api.Settings.settings(), &(&1.field.key == :console)).field.type
    text = File.read!(@docs)

    keys =
      for {path, _field} <- Aerie.Base.Settings.Schema.leaves(fields, ["console"]), do: Enum.join(path, ".")

    assert "console.map.layers" in keys
    assert Enum.reject(keys, &String.contains?(text, "| `#{&1}` |")) == []
  end

  describe "console.map" do
    defp checked(map) do
      case Aerie.Api.Settings.new(%{"console" => %{"map" => map}}) do
        {:ok, %{console: console} = settings} ->
          Aerie.Api.Settings.problems(Map.from_struct(%{settings | console: console}))

        {:error, problems} ->
          problems
      end
      |> Enum.map(&{Enum.join(&1.path, "."), &1.expected})
    end

    defp layer(more), do: Map.merge(%{"id" => "a", "url" => "https://t.example/{z}/{x}/{y}.png"}, more)

    test "takes layers of servers and files" do
      file = %{"id" => "f", "file" => "/srv/f.pmtiles"}

      keyed =
        layer(%{"url" => "https://t.example/{z}/{x}/{y}?k={key}", "key_file" => "/k", "kind" => "vector"})

      assert checked(%{"layers" => [keyed, file], "openstreetmap" => true}) == []
    end

    test "says what is wrong with a layer" do
      one = "console.map.layers.0"

      for {given, path, words} <- [
            {layer(%{"url" => "https://t.example/{z}/{x}.png"}), one <> ".url", "a URL such as"},
            {layer(%{"url" => "file:///etc/{z}/{x}/{y}"}), one <> ".url", "a URL such as"},
            {layer(%{"url" => "https://ann:pw@t.example/{z}/{x}/{y}"}), one <> ".url", "a URL such as"},
            {layer(%{"url" => "https://t.example/ {z}/{x}/{y}"}), one <> ".url", "a URL such as"},
            {layer(%{"url" => "https://t.example/{z}/{x}/{y}\r\nx: y"}), one <> ".url", "a URL such as"},
            {layer(%{"id" => "../x"}), one <> ".id", "a name"},
            {layer(%{"id" => "osm"}), one <> ".id", "another name"},
            {layer(%{"file" => "/x"}), one, "either url or file"},
            {%{"id" => "a"}, one, "either url or file"},
            {layer(%{"key_file" => "/k"}), one, "{key} in the url"},
            {layer(%{"min_zoom" => 9, "max_zoom" => 3}), one <> ".max_zoom", "min_zoom or more"}
          ] do
        assert [{^path, expected} | _] = checked(%{"layers" => [given]})
        assert expected =~ words
      end

      assert [{"console.map.layers", "each id once"}] = checked(%{"layers" => [layer(%{}), layer(%{})]})
      many = for n <- 1..21, do: layer(%{"id" => "a#{n}"})
      assert [{"console.map.layers", "at most 20 layers"}] = checked(%{"layers" => many})
    end

    test "the keys that were there before say what to write now" do
      assert {:error, [%{path: ["console", "tiles"], hint: "write map: {layers:" <> _}]} =
               Aerie.Api.Settings.new(%{"console" => %{"tiles" => "/x"}})
    end
  end
end
