defmodule Aerie.Fleet.Bridge.Leaf.ConfigTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.{Leaf, NatsServer}
  alias Aerie.Fleet.Bridge.Settings

  defp leaf(keys, nats \\ %{}, more \\ %{}),
    do: Map.merge(%{"nats" => Map.put(nats, "leaf", keys)}, more)

  defp settings(raw) do
    {:ok, settings} = Settings.new(raw)
    settings
  end

  # As the whole configuration checks it, with the derived values.
  defp wrong(raw) do
    for %{path: path, expected: expected, got: got} <- Settings.problems(settings(raw)),
        do: "#{Enum.join(path, ".")}: #{expected}; #{got}"
  end

  @well %{"url" => "tls://hub.example", "nkey_seed_file" => "/k/leaf.nk"}

  test "a hub's address, one secret, a domain of its own" do
    assert wrong(leaf(@well)) == []
    assert %{leaf: %{url: ["tls://hub.example:7422"]}, domain: "leaf"} = settings(leaf(@well)).nats
    assert settings(leaf(@well, %{}, %{"vehicle_id" => "VID-7"})).nats.domain == "VID-7"
    assert settings(leaf(@well, %{"domain" => "mine"})).nats.domain == "mine"
    assert %{leaf: %{url: []}, domain: nil} = settings(%{}).nats
  end

  test "contradictions are refused, each with what is expected" do
    for {raw, text} <- [
          {leaf(Map.delete(@well, "nkey_seed_file")), "nats.leaf: nkey_seed_file or credentials"},
          {leaf(Map.put(@well, "credentials", "/k/leaf.creds")), "nats.leaf: one way to sign in"},
          {leaf(%{"nkey_seed_file" => "/k"}),
           "nats.leaf.url: the hub's address beside nats.leaf.nkey_seed_file"},
          {leaf(%{@well | "url" => "tls://a:secret@hub"}), "nats.leaf.url: no password in the address"},
          {leaf(%{@well | "url" => ["tls://a", "nats://b"]}), "nats.leaf.url: tls:// for all"},
          {leaf(Map.put(@well, "tls", %{"cert_file" => "/c"})),
           "nats.leaf.tls: cert_file and key_file together"},
          {leaf(%{@well | "url" => "nats://hub"} |> Map.put("tls", %{"ca_file" => "/c"})),
           "nats.leaf.url: tls:// for nats.leaf.tls"},
          {leaf(@well, %{"url" => "nats://hub"}), "nats.leaf.url: nats.mode embedded"},
          {%{"nats" => %{"url" => "nats://hub", "domain" => "d"}}, "nats.domain: nats.mode embedded"},
          {%{"nats" => %{"streams" => %{"replicas" => 3}}},
           "nats.streams.replicas: 1 with nats.mode embedded"}
        ] do
      assert [problem | _] = wrong(raw)
      assert problem =~ text
      refute problem =~ "secret"
    end
  end

  test "a way to the hub that others can read is warned of" do
    assert [warning] = Settings.warnings(settings(leaf(%{@well | "url" => "nats://hub"})))
    assert warning =~ "nats.leaf.url is not tls://"
    assert Settings.warnings(settings(leaf(%{@well | "url" => "nats://127.0.0.1"}))) == []
  end

  test "the server's configuration has what the section says" do
    raw = leaf(Map.put(@well, "tls", %{"ca_file" => "/k/ca.pem"}))
    text = Leaf.Config.render(settings(raw).nats.leaf, "SU1")
    assert text =~ ~s(urls: ["tls://hub.example:7422"])
    assert text =~ ~s(nkey: "SU1")
    assert text =~ ~s(ca_file: "/k/ca.pem")
    assert Leaf.Config.render(settings(%{}).nats.leaf, nil) == ""

    nats = Map.merge(settings(raw).nats, %{name: "n", port: 0, token: "t", seed: "SU1"})
    assert NatsServer.Settings.render(nats) =~ ~s(domain: "leaf")
  end
end
