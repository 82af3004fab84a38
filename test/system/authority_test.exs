defmodule Aerie.System.AuthorityTest do
  @moduledoc """
  What reaches a vehicle, generated from the definitions: every message and every command, with extremes in their fields, from everybody
  who can send anything, by every way in. It is counted at the vehicle's socket and compared with `MavCodec.Meaning.Messages` and
  the roles.
  """

  use Aerie.SystemCase, async: true

  import Aerie.AuthorityCase

  alias Aerie.{AllFrames, CountingVehicle, Program}
  alias MavCodec.Meaning.Messages
  alias Aerie.Control.Policy.{Mavlink, Roles}
  alias MavCodec.Dialects.All
  alias MavCodec.Frame
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag capture_log: true

  @heartbeat M.Heartbeat.id()
  @carriers [M.CommandLong.id(), M.CommandInt.id()]
  # Of these a row does not say by itself who may.
  @judged [M.FileTransferProtocol.id(), M.RemoteLogBlockStatus.id(), M.CommandCancel.id()] ++ @carriers
  @commands 0..65_535
  @targets [{1, 1}, {1, 0}, {0, 0}]
  @vehicle %{autopilot: :ardupilot, vehicle_type: "copter"}

  @viewer_key "key-of-the-viewer-00001"
  @operator_key "key-of-the-operator-001"
  @admin_key "key-of-the-admin-000001"

  # A sample of everything that fits into the time of every run, and everything.
  @some %{
    messages: [targets: @targets, fills: [:max], versions: [2]],
    more: [targets: [{1, 1}], fills: [:zero, :nan], versions: [1]],
    commands: [targets: [{1, 1}, {0, 0}], fills: [:force], versions: [2]]
  }
  @all %{
    messages: [targets: @targets, fills: [:zero, :max, :nan, :infinity], versions: [1, 2]],
    more: [targets: [{1, 1}], fills: [:max], versions: [2], component: 250],
    commands: [targets: @targets, fills: AllFrames.fills(), versions: [1, 2]]
  }

  describe "a viewer, a stranger and another vehicle reach a vehicle with nothing" do
    test("by every way in", c, do: nobody(c.tmp_dir, @some))

    @tag :long
    @tag timeout: 1_800_000
    test("by every way in, with everything", c, do: nobody(c.tmp_dir, @all))
  end

  describe "an operator and an admin reach it with what their role has" do
    test("by every way in", c, do: roles(c.tmp_dir, @some))

    @tag :long
    @tag timeout: 1_800_000
    test("by every way in, with everything", c, do: roles(c.tmp_dir, @all))
  end

  test "strangers and viewers reach no vehicle that signs, whether they sign or not", %{tmp_dir: folder} do
    file = private_file(folder, "network.key", "a-passphrase-of-the-system-tests")
    signing = %{"dir" => Path.join(folder, "signing"), "keys" => [%{"key_file" => file}]}

    c =
      start_authority(folder, [:viewer],
        key: MavCodec.Signing.key("a-passphrase-of-the-system-tests"),
        overrides: %{"signing" => signing}
      )

    # As itself, as the vehicle, with another key, and with the right one, which is not a permission.
    signers = [{230, nil}, {1, nil}, {231, "another key"}, {232, "a-passphrase-of-the-system-tests"}]

    for {system, passphrase} <- signers, address = lan_address() || flunk_without_address() do
      stranger = program(c, {:link, address})
      Program.deliver(stranger, system |> everything(@some, [@heartbeat]) |> signed(passphrase))
    end

    viewer = program(c, {:udp, "viewer-udp"})
    Program.deliver(viewer, everything(201, @some, []))
    counts = settle(c)
    reached_nothing(counts, [230, 1, 231, 232, 201], "somebody")
    asked_by_gateway(counts)
  end

  defp signed(frames, nil), do: frames

  defp signed(frames, passphrase) do
    signing = passphrase |> MavCodec.Signing.key() |> MavCodec.Signing.new()

    {frames, _signing} =
      frames
      |> Enum.filter(&match?(<<0xFD, _::binary>>, &1))
      |> Enum.map_reduce(signing, &MavCodec.Signing.sign(&2, &1, frame(&1).crc_extra || 0))

    frames
  end

  defp nobody(folder, sample) do
    # An entry without an id is for everybody who is not named: WebSockets and mavlink.sock.
    c = start_authority(folder, [:viewer], clients: [%{"role" => "viewer"}])

    viewers = [
      {201, program(c, {:udp, "viewer-udp"})},
      {202, program(c, {:tcp, "viewer-tcp"})},
      {203, program(c, {:websocket, nil})},
      {204, program(c, :unix)}
    ]

    # Nobody is a ground station on a link from another address.
    address = lan_address() || flunk_without_address()
    stranger = {230, program(c, {:link, address})}
    other = {77, program(c, {:link, address})}

    [{viewers, []}, {[stranger], [@heartbeat]}, {[other], [@heartbeat]}]
    |> Enum.flat_map(fn {programs, except} -> Enum.map(programs, &Tuple.insert_at(&1, 2, except)) end)
    |> in_parallel(fn {system, program, except} ->
      hello = if system == 77, do: vehicle_heartbeat(77), else: station(system)
      Program.deliver(program, [hello])
      Program.deliver(program, everything(system, sample, except))
    end)

    counts = settle(c)
    reached_nothing(counts, [201, 202, 203, 204], "a viewer")
    reached_nothing(counts, [230], "a stranger")

    counts
    |> Map.reject(&match?({{@heartbeat, 77, _, _}, _n}, &1))
    |> reached_nothing([77], "another vehicle")

    asked_by_gateway(counts)
  end

  defp roles(folder, sample) do
    keys =
      private_file(folder, "keys", """
      vera #{@viewer_key} role=viewer
      olga #{@operator_key} role=operator
      anna #{@admin_key} role=admin
      """)

    c = start_authority(folder, [:operator, :admin], overrides: %{"api" => %{"keys_file" => keys}})

    programs = [
      {:viewer, 201, program(c, {:websocket, @viewer_key})},
      {:operator, 211, program(c, {:udp, "operator-udp"})},
      {:operator, 212, program(c, {:tcp, "operator-tcp"})},
      {:operator, 213, program(c, {:websocket, @operator_key})},
      # Nobody named it, and it is on this machine.
      {:operator, 214, program(c, :unix)},
      {:admin, 221, program(c, {:udp, "admin-udp"})},
      {:admin, 222, program(c, {:tcp, "admin-tcp"})},
      {:admin, 223, program(c, {:websocket, @admin_key})}
    ]

    in_parallel(programs, fn {_role, system, program} ->
      Program.deliver(program, [station(system)])
      Program.deliver(program, everything(system, sample, []))
    end)

    counts = settle(c)
    for {role, system, _program} <- programs, do: at_most(counts, role, system)
    for {role, system, program} <- programs, do: believed(c, role, system, program)
    asked_by_gateway(counts)
  end

  # Nothing that the role lacks, whatever is in the fields.
  defp at_most(counts, role, system) do
    may = Roles.permissions(role)

    too_much =
      for {{id, ^system, command, seq}, _n} <- counts,
          not allowed?(id, command, Enum.at(AllFrames.fills(), seq), may),
          do: {told(id, command), Enum.at(AllFrames.fills(), seq)}

    assert too_much == [], "#{role} #{system} reached the vehicle with #{inspect(too_much, limit: 30)}"
  end

  defp allowed?(id, command, fill, may) when id in @carriers do
    for bytes <- AllFrames.commands(1, commands: [command], targets: [{1, 1}], fills: [fill], versions: [2]),
        %{id: ^id} = frame <- [frame(bytes)],
        reduce: false do
      allowed? -> allowed? or permitted?(frame, may)
    end
  end

  defp allowed?(id, _command, _fill, may) do
    case Messages.row(id) do
      nil -> false
      %{permission: permission} -> permission in may
    end
  end

  defp permitted?(frame, may) do
    {:ok, message} = MavCodec.decode(frame)

    case Mavlink.facts(message, @vehicle) do
      :free -> :telemetry in may
      %{permission: permission} -> permission in may
    end
  end

  # What the role has must get there, too: a gate that is shut keeps everybody out.
  defp believed(c, role, system, program) do
    may = Roles.permissions(role)

    wanted =
      for id <- All.ids(),
          %{order?: false, class: class, permission: permission} <- [Messages.row(id)],
          class in [:telemetry, :input, :presence] and permission in may and permission != :manual,
          do: id

    except = All.ids() -- wanted
    frames = AllFrames.messages(system, targets: [{1, 1}], fills: [:zero], versions: [2], except: except)

    eventually(
      fn ->
        got = for {{id, ^system, _command, _seq}, _n} <- CountingVehicle.counts(c.vehicle), do: id
        missing = Enum.filter(frames, &(frame(&1).id in (wanted -- got)))
        if missing != [], do: Program.deliver(program, missing)
        missing == []
      end,
      "#{role} #{system} reaches the vehicle with all that the role has"
    )
  end

  # Questions of those who may not ask are few, and the gateway's own.
  defp asked_by_gateway(counts) do
    lists = for {{id, 237, _command, _seq}, n} <- counts, id == M.ParamRequestList.id(), do: n
    assert Enum.sum(lists) <= 10
    orders = for {{id, 237, nil, _seq}, _n} <- counts, Messages.order?(id), do: told(id, nil)
    assert Enum.uniq(orders) -- ["REQUEST_DATA_STREAM"] == []

    commands = for {{_id, 237, command, _seq}, _n} when command in @commands <- counts, do: command
    assert Enum.reject(Enum.uniq(commands), &reads?/1) == []
  end

  defp reads?(command) do
    name = to_string(MavCodec.Enums.MavCmd.name(command))
    MavCodec.Meaning.Commands.question?(command) or name == "MAV_CMD_SET_MESSAGE_INTERVAL"
  end

  defp everything(system, sample, except) do
    AllFrames.messages(system, [except: except ++ @judged] ++ sample.messages) ++
      AllFrames.messages(system, [except: except] ++ sample.more) ++
      AllFrames.commands(system, sample.commands) ++ AllFrames.invented(system)
  end

  defp frame(bytes) do
    frame = Frame.from_bytes(bytes, nil)
    %{frame | crc_extra: All.crc_extra(frame.id)}
  end

  defp in_parallel(programs, fun) do
    programs
    |> Task.async_stream(fun, max_concurrency: length(programs), timeout: :infinity, ordered: false)
    |> Stream.run()
  end

  defp vehicle_heartbeat(system) do
    MavCodec.encode(%M.Heartbeat{type: 2, autopilot: 3, base_mode: 0x51, mavlink_version: 3},
      system: system,
      component: 1
    )
  end

  defp flunk_without_address,
    do: flunk("this machine has no IPv4 address but loopback: nobody can be a stranger on a link")
end
