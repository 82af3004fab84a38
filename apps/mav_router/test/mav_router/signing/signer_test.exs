defmodule MavRouter.Signing.SignerTest do
  @moduledoc "What goes out signed, with which key, and what does not."
  use ExUnit.Case, async: true
  use Aerie.SigningCase

  alias Aerie.Base.Store
  alias MavRouter.Client.LocalEndpoint
  alias MavRouter.{Router, Signing}
  alias MavCodec.{Frame, Parser}
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag :capture_log

  defp parsed(bytes), do: elem(Parser.push_datagram(Parser.new(), IO.iodata_to_binary(bytes)), 0)
  defp by?(frame, passphrase), do: match?({:signed, _}, MavCodec.Signing.check(signer(passphrase), frame))

  # Keys of vehicles by passphrase.
  defp start(dir, keys, more \\ []) do
    keys =
      for {system, passphrase} <- keys do
        Map.merge(
          %{network: "main", key_file: key_file(dir, passphrase)},
          if(system, do: %{system_id: system}, else: %{})
        )
      end

    start_parts(%{signing: %{keys: keys, dir: Path.join(dir, "signing")}},
      before: [{Signing.Supervisor, more}]
    )
  end

  describe "what is for everybody" do
    test "is signed with the key of the other end, each peer's own", c do
      gateway = start(c.tmp_dir, [{1, "one"}, {2, "two"}])
      ours = Signing.mark(gateway, {"main", nil}, heartbeat(237, component: 191))
      # Nobody was heard, and there is no key for all: signed from the first frame on, for whoever it is.
      both = parsed(Signing.sign(gateway, "radio", :a, ours))
      assert [1, 1] = for(key <- ["one", "two"], do: Enum.count(both, &by?(&1, key)))

      for {peer, system, passphrase} <- [{:a, 1, "one"}, {:b, 2, "two"}] do
        {bytes, _} = signed(signer(passphrase), system)
        assert [_] = Signing.admit(gateway, source(peer: peer), [frame(bytes)])
        assert [frame] = parsed(Signing.sign(gateway, "radio", peer, ours))
        assert by?(frame, passphrase)
      end
    end

    test "goes once for each key where several vehicles share a radio; once where they share the key", c do
      gateway = start(c.tmp_dir, [{nil, "all"}, {2, "two"}])
      ours = Signing.mark(gateway, {"main", nil}, heartbeat(237, component: 191))
      # Before anything was heard the network's key is taken.
      assert [frame] = parsed(Signing.sign(gateway, "radio", :a, ours))
      assert by?(frame, "all")

      {three, signer} = signed(signer("all"), 3)
      {four, _} = signed(signer, 4)
      assert [_, _] = Signing.admit(gateway, source(peer: :a), [frame(three), frame(four)])
      assert [_once] = parsed(Signing.sign(gateway, "radio", :a, ours))

      {two, _} = signed(signer("two"), 2)
      assert [_] = Signing.admit(gateway, source(peer: :a), [frame(two)])
      both = parsed(Signing.sign(gateway, "radio", :a, ours))
      assert [1, 1] = for(key <- ["all", "two"], do: Enum.count(both, &by?(&1, key)))
    end

    test "a wrong signature proves no key to be there", c do
      gateway = start(c.tmp_dir, [{1, "one"}, {2, "two"}])
      {bytes, _} = signed(signer("another"), 1)
      assert [] = Signing.admit(gateway, source(peer: :a), [frame(bytes), frame(heartbeat(1))])
      ours = Signing.mark(gateway, {"main", nil}, heartbeat(237, component: 191))
      assert [_for_one, _for_two] = parsed(Signing.sign(gateway, "radio", :a, ours))
    end
  end

  describe "a client that is signed for" do
    setup c do
      gateway = start(c.tmp_dir, [{nil, "all"}])
      {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
      {:ok, vehicle} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])
      {bytes, _} = signed(signer("all"), 1)
      :ok = :gen_udp.send(vehicle, {127, 0, 0, 1}, port, bytes)
      eventually(fn -> Router.route(gateway, {"main", 1}) end)
      {:ok, gateway: gateway, vehicle: vehicle}
    end

    defp attach(gateway, options),
      do: with({:ok, e} <- LocalEndpoint.attach(gateway, [networks: ["main"]] ++ options), do: e)

    # What the vehicle gets from that system.
    defp heard(from, n) do
      receive do
        {:udp, _socket, _ip, _port, bytes} ->
          found = Enum.filter(parsed(bytes), &(&1.system == from))
          if length(found) >= n, do: found, else: found ++ heard(from, n - length(found))
      after
        Aerie.Patience.ms() -> flunk("nothing comes")
      end
    end

    defp read(id, options \\ []) do
      request = %M.ParamRequestRead{target_system: 1, target_component: 1, param_id: id, param_index: -1}
      MavCodec.encode(request, Keyword.merge([system: 255, component: 190], options))
    end

    test "its frames come signed, in their order, the time stamps too; what it signed or cannot be stays as it is (S10)",
         c do
      client = attach(c.gateway, id: "gcs", sign: true)
      {own, _} = MavCodec.Signing.sign(signer("its own"), read("A"), 214)
      old = read("B", version: 1)

      LocalEndpoint.ingress(
        client,
        parsed([read("C"), own, old, read("D"), heartbeat(255, component: 190, type: 6, autopilot: 8)])
      )

      got = heard(255, 5)
      assert Enum.map(got, &Frame.signed?/1) == [true, true, false, true, true]
      assert [_, %{bytes: ^own}, %{bytes: ^old}, _, _] = got
      assert [c1, _, _, d1, beat] = got
      assert Enum.all?([c1, d1, beat], &by?(&1, "all"))

      assert c1.signature.timestamp < d1.signature.timestamp and
               d1.signature.timestamp < beat.signature.timestamp

      assert {:ok, %{param_id: "C"}} = MavCodec.decode(c1)
    end

    test "it is believed, and is answered; one that is not signed for is neither, and goes out as it came",
         c do
      client = attach(c.gateway, id: "gcs", sign: true)
      LocalEndpoint.ingress(client, parsed(read("A")))
      assert Router.route(c.gateway, {"main", 255}) == {"gcs", :self}

      other = attach(c.gateway, id: "other")
      bytes = read("A", system: 254)
      LocalEndpoint.ingress(other, parsed(bytes))
      assert [%{bytes: ^bytes}] = heard(254, 1)
      assert Router.route(c.gateway, {"main", 254}) == nil
    end

    test "its frames are counted once, and the recorder's copy of a key that goes out has no key in it (S9)",
         c do
      client = attach(c.gateway, id: "gcs", sign: true)
      before = Store.counter(c.gateway, {:signing, "radio", :signed})
      LocalEndpoint.ingress(client, parsed(read("A")))
      assert [signed] = heard(255, 1)
      assert Store.counter(c.gateway, {:signing, "radio", :signed}) >= before + 1
      assert byte_size(signed.bytes) == byte_size(read("A")) + 13

      key = :binary.copy(<<0xAB>>, 32)
      setup = MavCodec.encode(%M.SetupSigning{target_system: 1, secret_key: key}, system: 237, component: 191)
      marked = {:secret, nil, Aerie.Base.Secret.new(setup)}
      refute inspect(marked) =~ "AB"
      assert Signing.sign(c.gateway, "radio", :a, marked) == setup
      refute IO.iodata_to_binary(Signing.without_key(marked, setup)) =~ key
      assert Signing.without_key(setup, setup) == setup
    end

    test "S8: its SETUP_SIGNING goes nowhere, signed for or not", c do
      client = attach(c.gateway, id: "gcs", sign: true)
      key = MavCodec.encode(%M.SetupSigning{target_system: 1, secret_key: "x"}, system: 255, component: 190)
      LocalEndpoint.ingress(client, parsed([key, read("A")]))
      assert [%{id: 20}] = heard(255, 1)
    end
  end

  test "only a client can be signed for" do
    assert {:error, "sign: only a client" <> _} = MavRouter.Endpoints.Owner.new("radio", sign: true)
    assert {:ok, %{sign: true}} = MavRouter.Endpoints.Owner.new("gcs", side: :client, sign: true)
    assert {:error, "sign: " <> _} = MavRouter.Endpoints.Owner.new("gcs", side: :client, sign: "yes")
  end
end
