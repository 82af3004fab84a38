defmodule Aerie.System.PilotTest do
  @moduledoc "What the role `pilot` opens, by every way in: a client's endpoint, REST, NATS, and a user of the console."

  use Aerie.SystemCase, async: true

  alias Aerie.Control.Params
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.Users
  alias MavCodec.{Frame, Parser}
  alias MavCodec.Messages, as: M
  alias MavRouter.Link

  @moduletag :tmp_dir
  @moduletag capture_log: true
  @keys %{pilot: "key-of-the-pilot-00001", operator: "key-of-the-operator-01"}

  setup %{tmp_dir: folder} do
    keys = private_file(folder, "keys", for({role, key} <- @keys, do: "#{role} #{key} role=#{role}\n"))
    listed = for role <- ["pilot", "operator"], do: %{"id" => role, "role" => role}

    overrides = %{
      "policy" => %{
        "clients" => listed,
        "unsigned" => "pilot"
      },
      "clients" => for(%{"id" => id} <- listed, do: %{"id" => id, "url" => "udpin:127.0.0.1:0"}),
      "api" => %{"keys_file" => keys},
      "timeouts" => patient()
    }

    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: overrides)
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    start_supervised!({SimVehicle, firmware: :ardupilot, ready_s: 1.0, link: link})
    Aerie.BridgeCase.await_listening(gateway, ["VID-001"])
    %{gateway: gateway}
  end

  defp value(c, name) do
    {:ok, %{value: value}} = Params.get(c.gateway, "VID-001", name)
    value
  end

  test "REST: a pilot's key sets a height and a speed, and nothing beyond", c do
    put = fn role, name, value ->
      path = "vehicles/VID-001/params/#{name}"
      c.gateway |> rest(:put, path, %{"value" => value}, key: @keys[role]) |> elem(0)
    end

    assert put.(:pilot, "RTL_ALT", 2_500) == 200
    assert value(c, "RTL_ALT") == 2_500

    for {role, name, value} <- [
          {:pilot, "RTL_ALT", 90_000},
          {:pilot, "FENCE_ENABLE", 1},
          {:operator, "RTL_ALT", 3_000}
        ],
        do: assert(put.(role, name, value) == 403, inspect({role, name}))

    assert value(c, "RTL_ALT") == 2_500
  end

  test "NATS: a source that is a pilot", c do
    ask = fn body ->
      {:ok, %{body: reply}} =
        Gnat.request(nats_client(c.gateway), "fleet.test.VID-001.params.set", JSON.encode!(body),
          receive_timeout: Aerie.Patience.ms()
        )

      JSON.decode!(reply)
    end

    assert %{"result" => "completed"} = ask.(%{"id" => "a", "name" => "WPNAV_SPEED", "value" => 400})

    assert %{"result" => "denied", "rule" => "role"} =
             ask.(%{"id" => "b", "name" => "FS_THR_ENABLE", "value" => 0})
  end

  test "console: a user who is a pilot", c do
    assert :ok = Users.add(c.gateway, "pia", "pilot", "a-password-of-pia", "boss")
    pia = Roles.principal(:user, "pia", :pilot)
    assert {:ok, %{status: :completed}} = Params.set(c.gateway, "VID-001", "LAND_SPEED", 40, as: pia)
    assert {_denied, %{status: :denied}} = Params.set(c.gateway, "VID-001", "ARMING_CHECK", 0, as: pia)
  end

  test "MAVLink: a client that is a pilot", c do
    [pilot, operator] =
      for id <- ["pilot", "operator"] do
        port = eventually(fn -> Link.snapshot(c.gateway, id).port end, "#{id} is open")
        {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])
        :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, port)
        socket
      end

    set = fn socket, name, value ->
      message = %M.ParamSet{
        target_system: 1,
        target_component: 1,
        param_id: name,
        param_value: value,
        param_type: 9
      }

      :ok = :gen_udp.send(socket, MavCodec.encode(message, system: 255, component: 190))
      text_or_value(socket, name)
    end

    assert {:value, 3_500.0} = set.(pilot, "RTL_ALT", 3_500.0)

    assert {:refused, "refused: setting RTL_ALT needs the permission" <> _} =
             set.(operator, "RTL_ALT", 1_500.0)

    assert {:refused, "refused: setting FENCE_ACTION needs" <> _} = set.(pilot, "FENCE_ACTION", 0.0)
    assert value(c, "RTL_ALT") == 3_500
  end

  # The answer to a set: the vehicle's value, or the first part of a refusal.
  defp text_or_value(socket, name) do
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, Aerie.Patience.ms())
    {frames, _parser} = Parser.push(Parser.new(), bytes)

    frames
    |> Enum.find_value(fn %Frame{} = frame ->
      case MavCodec.decode(frame) do
        {:ok, %M.ParamValue{param_id: ^name, param_value: value}} -> {:value, value}
        {:ok, %M.Statustext{text: "refused: setting " <> _ = text}} -> {:refused, text}
        _another -> nil
      end
    end) || text_or_value(socket, name)
  end
end
