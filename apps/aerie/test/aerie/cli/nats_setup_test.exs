defmodule Aerie.CLI.NatsSetupTest do
  use ExUnit.Case, async: true

  import Bitwise

  alias Aerie.Config

  @moduletag :tmp_dir

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
    refute read(dir, "hub/accounts.conf") =~ ~r/\bSU[A-Z2-7]{50}/
    refute read(dir, "fleet.json") =~ ~r/\bSU[A-Z2-7]{50}/

    for {name, mode} <- [{"vehicles/VID-2/gateway.yaml", :embedded}, {"hub/gateway.yaml", :url}] do
      assert {:ok, %{nats: %{mode: ^mode}, environment: "prod"}} =
               Config.load(Path.join([dir, "set", name]), [], env: %{})
    end

    # The hub shows and commands its vehicles, which list the key by which it signs.
    %{"gateway" => public} = JSON.decode!(read(dir, "fleet.json"))

    assert {:ok, %{remote: %{enabled: true, nkey_seed_file: "gateway.nk"}}} =
             Config.load(Path.join([dir, "set/hub/gateway.yaml"]), [], env: %{})

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
    assert text =~ ~r"A: shadow.vehicle_key in its gateway.yaml is what \S+/vehicles/A/shadow.key has"
    refute text =~ "D: shadow.vehicle_key"

    assert read(dir, "vehicles/A/shadow.key") ==
             Aerie.Fleet.Shadow.Keys.derive(String.trim(read(dir, "shadow.key")), "test", "A") <> "\n"

    refute read(dir, "shadow.key") == old
    {:ok, %{shadow: shadow}} = Config.load(Path.join([dir, "set/hub/gateway.yaml"]), [], env: %{})
    assert Aerie.Base.Secret.reveal(shadow.former_key) == String.trim(old)
    accounts = read(dir, "hub/accounts.conf")
    assert accounts =~ ~s("vehicle-C") and accounts =~ "fleet.test.A.event.armed"
    refute accounts =~ "vehicle-B"
  end

  test "another key for the hub's gateways, and for a vehicle that is taken out and added again", %{
    tmp_dir: dir
  } do
    {:ok, text} = setup_in(dir, ~w(--host hub --vehicle A --vehicle B))
    assert text =~ "the key of the hub's gateways is new: #{dir}/set/hub/gateway.nk"

    keys = fn ->
      for name <- ~w(hub/gateway.nk vehicles/A/leaf.nk vehicles/B/leaf.nk), do: public(dir, name)
    end

    [gateway, a, b] = keys.()
    assert {:ok, text} = setup_in(dir, ["--new-gateway-key"])
    assert text =~ "the key of the hub's gateways is new"
    assert [other, ^a, ^b] = keys.()
    accounts = read(dir, "hub/accounts.conf")
    assert accounts =~ other and accounts =~ a and not (accounts =~ gateway)
    assert {:ok, text} = setup_in(dir, ~w(--revoke A --vehicle A))
    refute text =~ "the hub's gateways"
    assert [^other, again, ^b] = keys.()
    accounts = read(dir, "hub/accounts.conf")
    assert accounts =~ again and not (accounts =~ a)
  end

  defp public(dir, name) do
    {:ok, key} = Nkey.from_seed(read(dir, name))
    key.public
  end

  test "what cannot be is said, and nothing is written", %{tmp_dir: dir} do
    for {words, said} <- [
          {["set"], "the hub's name is missing: --host"},
          {~w(set --host hub --vehicle a.b), "a name has at most 64 letters"},
          {~w(set --host a/b), "--host is a name such as"},
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
  end
end
