defmodule Aerie.Config.ListingTest do
  use ExUnit.Case, async: true

  alias Aerie.Config
  alias Aerie.Config.{Keys, Listing}
  alias Aerie.Base.Settings.Schema

  defp keys(config),
    do: for(section <- Listing.sections(config), key <- section.keys, into: %{}, do: {key.path, key})

  test "each key is there once, in words, and by default says that it is the default" do
    sections = Listing.sections(Config.default())
    paths = for section <- sections, key <- section.keys, do: key.path
    all = for {path, _field} <- Schema.leaves(Keys.fields()), do: Enum.join(path, ".")
    assert Enum.sort(paths) == Enum.sort(all)
    assert hd(sections).name == "gateway"

    for section <- sections, key <- section.keys do
      assert key.source == nil, key.path
      assert String.valid?(key.value) and key.value != "", key.path
    end

    assert %{value: "4000", default: "4000", expected: "an integer from 0 to 65535"} =
             keys(Config.default())["http.port"]

    assert keys(Config.default())["shadow.hold_s"].unit == "s"
  end

  test "what was set says by what, and no secret is in it" do
    {:ok, config} =
      Config.load(nil, [{"http.port", 4711}],
        env: %{
          "AERIE_API_KEY" => "a-very-secret-key-0001",
          "AERIE_SHADOW_KEY" => "the-shadow-secret",
          "AERIE_NATS_URL" => "nats://joe:the-nats-secret@hub.example:4222",
          "AERIE_LINKS" => ~s([{id: radio, url: "udpin:0.0.0.0:14551"}])
        }
      )

    keys = keys(config)
    assert %{value: "4711", default: "4000", source: "command line"} = keys["http.port"]
    assert %{value: "set", default: "not set", source: "environment variable AERIE_API_KEY"} = keys["api.key"]
    assert keys["nats.url"].value =~ "hub.example:4222"
    assert keys["links"].value =~ "udpin:0.0.0.0:14551"
    text = inspect(Listing.sections(config), limit: :infinity, printable_limit: :infinity)

    for secret <- ["a-very-secret-key-0001", "the-shadow-secret", "the-nats-secret"],
        do: refute(text =~ secret)
  end
end
