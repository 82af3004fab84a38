defmodule Aerie.Vehicle.Enrolment.RotationTest do
  @moduledoc "Somebody gives a vehicle another key, and waits for the proof that it has it."
  use ExUnit.Case, async: true
  use Aerie.SigningCase

  alias MavRouter.Signing

  @moduletag :tmp_dir
  @moduletag :capture_log
  @key {"main", 1}

  setup c do
    key = key_file(c.tmp_dir)
    {:ok, key: key, gateway: start_signing(c.tmp_dir, key_file: key), dir: Path.join(c.tmp_dir, "signing")}
  end

  defp keys(gateway), do: for(%{key: key} <- Signing.list(gateway).keys, do: key)

  describe "while somebody waits for the proof" do
    setup c do
      {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0?secure=true", id: "usb")
      {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])
      {:ok, port: port, socket: socket}
    end

    defp say(c, bytes), do: :ok = :gen_udp.send(c.socket, {127, 0, 0, 1}, c.port, bytes)

    # The order to take a key, as the vehicle gets it; other frames for it come in between.
    defp order(c) do
      assert_receive {:udp, _socket, _from, _port, bytes}
      {frames, _} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes)
      Enum.find(frames, &(&1.id == 256)) || order(c)
    end

    test "the old key's frames prove nothing, whenever they come; the error says that the vehicle still has it",
         c do
      {bytes, signer} = signed(signer(), 1)
      say(c, bytes)
      eventually(fn -> MavRouter.Router.route(c.gateway, @key) end)
      {setup_signing, error} = enrolled_in_vain(c, signer)
      # Signed with the key in force.
      assert {:signed, _} = MavCodec.Signing.check(signer, setup_signing)
      assert Exception.message(error) =~ "it still signs with its former key"
      assert Signing.list(c.gateway).pending == ["main/1"]

      # It had taken it after all.
      {:ok, %{secret_key: key}} = MavCodec.decode(setup_signing)
      {bytes, _} = MavCodec.Signing.sign(MavCodec.Signing.new(key), heartbeat(1), 50)
      say(c, bytes)
      eventually(fn -> Signing.list(c.gateway).pending == [] end)
      assert "main/1" in keys(c.gateway)
    end

    # On a busy machine two seconds may be over before anything of the vehicle was heard: then once more.
    defp enrolled_in_vain(c, signer) do
      task =
        Task.async(fn ->
          Aerie.Vehicle.Enrolment.enrol(c.gateway, @key, key: :generate, timeout_ms: 2_000)
        end)

      setup_signing = order(c)
      assert {:error, %Aerie.Base.Error{} = error} = says_until_done(task, c, signer)

      if Exception.message(error) =~ "nothing from component",
        do: enrolled_in_vain(c, signer),
        else: {setup_signing, error}
    end

    # Signed frames, from now until the answer is there.
    defp says_until_done(task, c, signer) do
      {bytes, signer} = signed(signer, 1)
      say(c, bytes)
      with nil <- Task.yield(task, 20), do: says_until_done(task, c, signer), else: ({:ok, answer} -> answer)
    end

    test "another component of the vehicle proves nothing either", c do
      {bytes, signer} = signed(signer(), 1)
      say(c, bytes)
      eventually(fn -> MavRouter.Router.route(c.gateway, @key) end)
      task = Task.async(fn -> Aerie.Vehicle.Enrolment.revoke(c.gateway, @key, timeout_ms: 400) end)
      order(c)
      # A camera that never signs.
      for n <- 1..5, do: say(c, heartbeat(1, component: 100, autopilot: 8, seq: n))
      {bytes, _} = signed(signer, 1)
      say(c, bytes)

      assert {:error, %{reason: {:unavailable, "no unsigned frame came on link usb" <> _}}} =
               Task.await(task, Aerie.Patience.ms())
    end

    test "a second request gets an error; an armed vehicle is left alone; a key itself is not an argument",
         c do
      {bytes, _signer} = signed(signer(), 1)
      say(c, bytes)
      eventually(fn -> MavRouter.Router.route(c.gateway, @key) end)
      patience = Aerie.Patience.ms()

      task =
        Task.async(fn ->
          Aerie.Vehicle.Enrolment.enrol(c.gateway, @key, key: :generate, timeout_ms: patience)
        end)

      {:ok, %{secret_key: key}} = MavCodec.decode(order(c))

      assert {:error, %{reason: {:conflict, "another enrolment of this vehicle is in progress"}}} =
               Aerie.Vehicle.Enrolment.enrol(c.gateway, @key)

      # The first one's goes on, until the vehicle proves that it has the key.
      {bytes, _} = MavCodec.Signing.sign(MavCodec.Signing.new(key), heartbeat(1), 50)
      say(c, bytes)
      assert {:ok, %{key: %Aerie.Base.Secret{}}} = Task.await(task, patience)

      assert {:error, %{reason: {:invalid, "key is {:file, " <> _}}} =
               Aerie.Vehicle.Enrolment.enrol(c.gateway, @key, key: "a passphrase")

      assert {:error, %Aerie.Base.Error{} = error} = Aerie.Vehicle.Enrolment.enrol(c.gateway, :vid_007)
      assert Exception.message(error) =~ ~s(like "VID-007")

      armed = %{id: "VID-001", key: @key, groups: %{mode: %{data: %{armed: true}}}}
      :ok = Aerie.Base.Store.put_vehicle(c.gateway, @key, armed)
      assert {:error, %Aerie.Base.Error{} = error} = Aerie.Vehicle.Enrolment.enrol(c.gateway, @key)
      assert Exception.message(error) =~ "is armed"
    end
  end
end
