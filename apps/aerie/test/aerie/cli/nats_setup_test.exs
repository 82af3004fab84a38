defmodule Aerie.CLI.NatsSetupTest do
  use ExUnit.Case, async: true

  import Bitwise

  alias Aerie.Config

  @moduletag :tmp_dir

  # A shell would take this name apart.
  setup %{tmp_dir: dir} do
    dir = Path.join(dir, "Jörg's $drones")
    File.mkdir_p!(dir)
    [tmp_dir: dir]
  end

  defp call(words, dir) do
    case Aerie.CLI.call(["nats-setup" | words], dir) do
      {0, text} -> {:ok, IO.iodata_to_binary(text)}
      error -> error
    end
  end

  defp setup_in(dir, words), do: call(["set" | words], dir)
  defp read(dir, name), do: File.read!(Path.join([dir, "set", name]))

  test "a set for a hub and two vehicles: secrets for their owner, configurations that load", %{tmp_dir: dir} do
    assert {:ok, text} = setup_in(dir, ~w(--host hub.example.org --vehicle VID-1 --vehicle VID-2))
    assert text =~ "VID-1: copy"

    for name <- ~w(ca.key hub/gateway.nk hub/hub.example.org/server.key vehicles/VID-1/leaf.nk) do
      %{mode: mode} = File.stat!(Path.join([dir, "set", name]))
      assert (mode &&& 0o077) == 0, name
    end

    # Public halves only.
    refute read(dir, "hub/hub.example.org/accounts.conf") =~ ~r/\bSU[A-Z2-7]{50}/
    refute read(dir, "fleet.json") =~ ~r/\bSU[A-Z2-7]{50}/

    for {name, mode} <- [{"vehicles/VID-2/gateway.yaml", :embedded}, {"hub/gateway.yaml", :url}] do
      assert {:ok, %{nats: %{mode: ^mode}, environment: "prod"}} =
               Config.load(Path.join([dir, "set", name]), [], env: %{})
    end

    # The hub shows and commands its vehicles, which list the key by which it signs.
    %{"gateway" => public} = JSON.decode!(read(dir, "fleet.json"))

    # The files beside it are meant, wherever the folder is.
    seed = Path.join([dir, "set/hub/gateway.nk"])

    assert {:ok, %{remote: %{enabled: true, nkey_seed_file: ^seed}} = hub} =
             Config.load(Path.join([dir, "set/hub/gateway.yaml"]), [], env: %{})

    assert {:ok, _warnings} = Config.Preflight.check(hub)

    assert {:ok, %{policy: %{sources: [%{name: "hub", nkey: ^public, role: :operator}]}}} =
             Config.load(Path.join([dir, "set/vehicles/VID-1/gateway.yaml"]), [], env: %{})

    # The hub has the key from which those of the vehicles are derived, a vehicle its own, and no server any.
    common = String.trim(read(dir, "shadow.key"))

    {:ok, %{shadow: %{key: key, former_key: nil}}} =
      Config.load(Path.join([dir, "set/hub/gateway.yaml"]), [], env: %{})

    assert Aerie.Base.Secret.reveal(key) == common

    for id <- ["VID-1", "VID-2"] do
      file = "vehicles/#{id}/gateway.yaml"

      {:ok, %{shadow: %{key: nil, vehicle_key: own}}} =
        Config.load(Path.join([dir, "set", file]), [], env: %{})

      assert Aerie.Base.Secret.reveal(own) == Aerie.Fleet.Shadow.Keys.derive(common, "prod", id)
      refute read(dir, file) =~ common
    end

    pem = read(dir, "hub/hub.example.org/server.pem")
    [{:Certificate, der, :not_encrypted}] = :public_key.pem_decode(pem)
    [{:Certificate, ca, :not_encrypted}] = :public_key.pem_decode(read(dir, "hub/ca.pem"))
    assert {:ok, _} = :public_key.pkix_path_validation(ca, [der], [])
    assert :public_key.pkix_verify_hostname(der, dns_id: ~c"hub.example.org")
  end

  test "run again it keeps keys, adds and takes out", %{tmp_dir: dir} do
    {:ok, _} = setup_in(dir, ~w(--host hub --environment test --vehicle A --vehicle B))
    seed = read(dir, "vehicles/A/leaf.nk")
    ca = read(dir, "ca.key")
    # As after they were moved to the vehicle.
    File.rm_rf!(Path.join(dir, "set/vehicles/B"))
    assert {:ok, text} = setup_in(dir, ~w(--vehicle C --vehicle A --revoke B))
    assert text =~ "B: its key opens nothing"
    assert {read(dir, "vehicles/A/leaf.nk"), read(dir, "ca.key")} == {seed, ca}
    refute text =~ "shadow.key"
    # A set of before each vehicle had a key of its own: the hub gets another one, and those aboard are told.
    old = read(dir, "shadow.key")
    fleet = dir |> read("fleet.json") |> JSON.decode!()
    File.write!(Path.join(dir, "set/fleet.json"), JSON.encode!(Map.delete(fleet, "sealing")))
    assert {:ok, text} = setup_in(dir, ~w(--vehicle D))
    assert text =~ ~r"A: shadow.vehicle_key in its gateway.yaml is what .+/vehicles/A/shadow.key has"
    refute text =~ "D: shadow.vehicle_key"

    assert read(dir, "vehicles/A/shadow.key") ==
             Aerie.Fleet.Shadow.Keys.derive(String.trim(read(dir, "shadow.key")), "test", "A") <> "\n"

    refute read(dir, "shadow.key") == old
    {:ok, %{shadow: shadow}} = Config.load(Path.join([dir, "set/hub/gateway.yaml"]), [], env: %{})
    assert Aerie.Base.Secret.reveal(shadow.former_key) == String.trim(old)
    accounts = read(dir, "hub/hub/accounts.conf")
    assert accounts =~ ~s("vehicle-C") and accounts =~ "fleet.test.A.event.armed"
    refute accounts =~ "vehicle-B"
  end

  test "another key for the hub's gateways, and for a vehicle that is taken out and added again", %{
    tmp_dir: dir
  } do
    {:ok, text} = setup_in(dir, ~w(--host hub --vehicle A --vehicle B))

    assert text =~
             "hub: its key is new; copy gateway.yaml, gateway.nk and ca.pem of #{dir}/set/hub to its gateway"

    keys = fn ->
      for name <- ~w(hub/gateway.nk vehicles/A/leaf.nk vehicles/B/leaf.nk), do: public(dir, name)
    end

    [gateway, a, b] = keys.()
    assert {:ok, text} = setup_in(dir, ~w(--new-key hub))
    assert text =~ "hub: its key is new"
    assert text =~ ~r"A, B: bring aboard what is new in .+/vehicles/ID/gateway.yaml \(policy.sources"
    assert text =~ "nats-server --signal reload=nats-server.pid"
    assert read(dir, "vehicles/A/gateway.yaml") =~ public(dir, "hub/gateway.nk")
    assert [other, ^a, ^b] = keys.()
    accounts = read(dir, "hub/hub/accounts.conf")
    assert accounts =~ other and accounts =~ a and not (accounts =~ gateway)
    assert {:ok, text} = setup_in(dir, ~w(--new-key A))
    assert text =~ "A: copy" and text =~ "restart nats-server"
    refute text =~ "hub: its key is new"
    assert [^other, again, ^b] = keys.()
    accounts = read(dir, "hub/hub/accounts.conf")
    assert accounts =~ again and not (accounts =~ a)
    # Taken out and added later, it has another one, too.
    assert {:ok, text} = setup_in(dir, ~w(--revoke A))
    assert text =~ "A: its key opens nothing" and text =~ "--signal reload"
    refute read(dir, "hub/hub/accounts.conf") =~ "vehicle-A"
    {:ok, _text} = setup_in(dir, ~w(--vehicle A))
    refute public(dir, "vehicles/A/leaf.nk") in [a, again]
  end

  test "another hub has its own key, which vehicles list beside the first one's", %{tmp_dir: dir} do
    {:ok, _text} = setup_in(dir, ~w(--host hub --vehicle A --vehicle B))

    kept =
      for name <- ~w(hub/gateway.nk vehicles/A/leaf.nk hub/hub/server.pem ca.pem), do: {name, read(dir, name)}

    # As after it was moved to the vehicle.
    File.rm_rf!(Path.join(dir, "set/vehicles/B"))
    assert {:ok, text} = setup_in(dir, ~w(--hub tower))
    assert text =~ "tower: its key is new; copy gateway.yaml, gateway.nk and ca.pem of #{dir}/set/hubs/tower"
    assert text =~ "A, B: bring aboard what is new" and text =~ "--signal reload"
    for {name, text} <- kept, do: assert(read(dir, name) == text, name)
    [first, tower] = for name <- ~w(hub/gateway.nk hubs/tower/gateway.nk), do: public(dir, name)
    assert read(dir, "hub/hub/accounts.conf") =~ "users: [ { nkey: #{first} }, { nkey: #{tower} } ]"
    assert read(dir, "hubs/tower/gateway.yaml") == read(dir, "hub/gateway.yaml")

    for id <- ["A", "B"] do
      assert {:ok, %{policy: %{sources: [%{name: "hub", nkey: ^first}, %{name: "tower", nkey: ^tower}]}}} =
               Config.load(Path.join([dir, "set/vehicles", id, "gateway.yaml"]), [], env: %{})
    end

    assert {:ok, text} = setup_in(dir, ~w(--revoke tower))
    assert text =~ "tower: its key opens nothing"
    refute read(dir, "hub/hub/accounts.conf") =~ tower
    refute read(dir, "vehicles/A/gateway.yaml") =~ tower
    refute File.exists?(Path.join(dir, "set/hubs/tower/gateway.nk"))
  end

  test "the same words again change nothing, not even if fleet.json was lost", %{tmp_dir: dir} do
    words = ~w(--host hub.example.org --vehicle A --hub tower)
    {:ok, _text} = setup_in(dir, words)
    before = files(dir)
    assert {:ok, "nothing has changed" <> _} = setup_in(dir, words)
    assert files(dir) == before
    File.rm!(Path.join(dir, "set/fleet.json"))
    assert {:ok, _text} = setup_in(dir, words)
    assert Map.drop(files(dir), ["fleet.json"]) == Map.drop(before, ["fleet.json"])

    assert read(dir, "fleet.json") |> JSON.decode!() |> get_in(["hubs", "tower"]) ==
             public(dir, "hubs/tower/gateway.nk")

    # A damaged key is not replaced behind one's back.
    File.write!(Path.join(dir, "set/vehicles/A/leaf.nk"), "SUnonsense")
    File.rm!(Path.join(dir, "set/fleet.json"))
    assert {:error, text} = setup_in(dir, words)
    assert text =~ ~r"vehicles/A/leaf.nk is not the seed of a user's nkey: restore it"
    assert read(dir, "vehicles/A/leaf.nk") == "SUnonsense"
  end

  test "the authority's key may be elsewhere until a server needs a certificate", %{tmp_dir: dir} do
    {:ok, _text} = setup_in(dir, ~w(--host a.example.org))
    File.rename!(Path.join(dir, "set/ca.key"), Path.join(dir, "ca.key"))
    ca = read(dir, "ca.pem")
    assert {:ok, _text} = setup_in(dir, ~w(--vehicle A))
    assert {:error, text} = setup_in(dir, ~w(--host b.example.org))
    assert text =~ "ca.key is missing: put it there"
    File.rename!(Path.join(dir, "ca.key"), Path.join(dir, "set/ca.key"))
    assert {:ok, text} = setup_in(dir, ~w(--host b.example.org))
    assert text =~ "A: bring aboard" and text =~ "nats.leaf.url"
    assert read(dir, "ca.pem") == ca
    refute text =~ "two servers" or text =~ "stored alone"
    assert {:ok, text} = setup_in(dir, ~w(--host b.example.org --host c.example.org))

    assert text =~ "two servers store nothing while one of them is away" and
             text =~ "what a server stored alone"

    assert read(dir, "vehicles/A/gateway.yaml") =~ ~s(["tls://b.example.org:7422","tls://c.example.org:7422"])
  end

  defp files(dir) do
    set = Path.join(dir, "set")

    for file <- Path.wildcard(Path.join(set, "**"), match_dot: true), File.regular?(file), into: %{} do
      {Path.relative_to(file, set), {:erlang.md5(File.read!(file)), File.stat!(file).inode}}
    end
  end

  # As they are typed, and as addresses and certificates have them.
  for {typed, address, name} <- [
        {"Hub.Example.ORG", "hub.example.org", {:dns_id, ~c"hub.example.org"}},
        {"hub.example.org.", "hub.example.org", {:dns_id, ~c"hub.example.org"}},
        {"field_hub", "field_hub", {:dns_id, ~c"field_hub"}},
        {"10.8.0.1", "10.8.0.1", {:ip, {10, 8, 0, 1}}},
        {"[2001:DB8:0::1]", "[2001:db8::1]", {:ip, {0x2001, 0xDB8, 0, 0, 0, 0, 0, 1}}},
        {"::1", "[::1]", {:ip, {0, 0, 0, 0, 0, 0, 0, 1}}},
        {String.duplicate("long-name.", 8) <> "org", String.duplicate("long-name.", 8) <> "org",
         {:dns_id, String.to_charlist(String.duplicate("long-name.", 8) <> "org")}}
      ] do
    test "a server #{typed}", %{tmp_dir: dir} do
      assert {:ok, _text} = setup_in(dir, ["--host", unquote(typed), "--vehicle", "A"])
      assert read(dir, "vehicles/A/gateway.yaml") =~ ~s(url: ["tls://#{unquote(address)}:7422"])

      assert {:ok, %{nats: %{leaf: %{url: [_]}}}} =
               Config.load(Path.join(dir, "set/vehicles/A/gateway.yaml"), [], env: %{})

      folder = String.trim(unquote(address), "[") |> String.trim("]")
      [{:Certificate, der, _}] = :public_key.pem_decode(read(dir, "hub/#{folder}/server.pem"))
      [{:Certificate, ca, _}] = :public_key.pem_decode(read(dir, "hub/ca.pem"))
      assert {:ok, _} = :public_key.pkix_path_validation(ca, [der], [])
      assert :public_key.pkix_verify_hostname(der, [unquote(Macro.escape(name))])
      refute :public_key.pkix_verify_hostname(der, dns_id: ~c"other.example.org")
    end
  end

  defp public(dir, name) do
    {:ok, key} = Nkey.from_seed(read(dir, name))
    key.public
  end

  test "what cannot be is said, and nothing is written", %{tmp_dir: dir} do
    for {words, said} <- [
          {["set"], "the hub's name is missing: --host"},
          {~w(set --host hub --vehicle a.b), "a name has at most 64 letters"},
          {~w(set --host a/b), "expected a name such as hub.example.org or an IP address: without a scheme"},
          {~w(set --host tls://hub.example.org), "without a scheme, a port or a path"},
          {~w(set --host hub:4222), "without a scheme, a port or a path"},
          {~w(set --host *.example.org), "not a wildcard"},
          {~w(set --host fe80::1%eth0), "without a zone"},
          {~w(set --host 10.0.0.256), "an IPv4 address has four numbers"},
          {~w(set --host hüb.example.org), "written in ASCII, as xn--"},
          {["set", "--host", "a b"], "expected a name such as"},
          {["set", "--host", ""], "expected a name such as"},
          {["set", "--host", String.duplicate("a", 64) <> ".org"], "at most 63"},
          {~w(set --host hub --hub hub), "the name of the first hub"},
          {~w(set --host hub --hub A --vehicle A), "a hub and a vehicle cannot have the same name"},
          {~w(set --host hub --revoke hub), "the first hub stays; --new-key hub"},
          {~w(set --host hub --new-key A), "there is no such vehicle or hub (hub)"},
          {~w(set --host hub --revoke X), "there is no such vehicle"},
          {[], "FOLDER is missing"},
          {~w(set --hots hub), "unknown option --hots; did you mean --host?"}
        ] do
      assert {:error, text} = call(words, dir)
      assert text =~ said
    end

    assert File.ls!(dir) == []
    assert {:ok, "usage: aerie nats-setup" <> _} = call(["--help"], dir)
    {:ok, _} = setup_in(dir, ~w(--host hub))
    assert {:error, text} = setup_in(dir, ~w(--environment other))
    assert text =~ "the fleet's environment is prod"
    {:ok, _} = setup_in(dir, ~w(--vehicle A))
    assert {:error, text} = setup_in(dir, ~w(--revoke A --new-key A))
    assert text =~ "A: --revoke takes it out, and --new-key gives it another key"
  end
end
