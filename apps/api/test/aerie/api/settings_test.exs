defmodule Aerie.Api.SettingsTest do
  use ExUnit.Case, async: true

  @docs Path.expand("../../../../../docs/console.md", __DIR__)

  test "docs/console.md has every key of the console" do
    {:section, fields} = Enum.find(Aerie.Api.Settings.settings(), &(&1.field.key == :console)).field.type
    text = File.read!(@docs)
    keys = for field <- fields, do: "console.#{field.key}"
    assert "console.tiles" in keys
    assert Enum.reject(keys, &String.contains?(text, "| `#{&1}` |")) == []
  end
end
