defmodule MavCodec.Msp.GuardTest do
  use ExUnit.Case, async: true

  import MavCodec.Test.Msp, only: [frame: 0]

  alias MavCodec.Msp.{Frame, Guard, Message, Messages, Payload}

  doctest MavCodec.Msp.Guard

  defp check(id, payload, options \\ []) do
    form = Keyword.get(options, :form, :v2)
    target = Keyword.get(options, :target, {:betaflight, {1, 46}})
    Guard.check(%Frame{form: form, id: id, payload: payload}, target)
  end

  defp refused(id, payload \\ "", options \\ []) do
    assert {:error, why} = check(id, payload, options)
    why
  end

  test "192 bytes, not more: Betaflight 4.5.5 died of 200" do
    assert {:ok, _} = check(0x3006, :binary.copy(<<0>>, 192))
    assert refused(0x3006, :binary.copy(<<0>>, 193)) =~ "193 bytes of payload"
  end

  test "an id above 254 only in version 2: 0x1007 in version 1 would be SET_INAV_PID" do
    target = [form: :v1, target: {:inav, {9, 0}}]
    assert refused(0x1007, "x", target) =~ "would become 7"
    assert {:ok, _} = check(0x1007, "x", form: :v2_over_v1, target: {:inav, {9, 0}})
  end

  test "a write ends where the firmware expects it" do
    assert {:ok, %{name: "SET_PID"}} = check(202, :binary.copy(<<1>>, 15))
    assert {:ok, _} = check(202, :binary.copy(<<1>>, 17))
    for size <- [0, 3, 14], do: assert(refused(202, :binary.copy(<<1>>, size)) =~ "it takes 15")
    assert {:ok, _} = check(95, :binary.copy(<<1>>, 47))
    assert refused(95, :binary.copy(<<1>>, 48)) =~ "it takes 17, 19, 23"
    # iNav refuses itself what is too long; some of its bytes would be lost.
    assert refused(35, :binary.copy(<<1>>, 7), target: {:inav, {9, 0}}) =~ "it takes 5"
    assert refused(200, <<1, 2, 3>>) =~ "a multiple of 2"
    assert refused(200, :binary.copy(<<1>>, 38)) =~ "at most 36"
    assert refused(214, <<0::64>>) =~ "at least 16"
  end

  # Each write that says itself how long it is, in each version that has it.
  @versions %{betaflight: for(minor <- 40..49, do: {1, minor}), inav: [{7, 0}, {8, 0}, {9, 0}, {9, 1}]}

  defp announcing do
    for {firmware, versions} <- @versions,
        version <- versions,
        %{kind: :write, never: nil} = message <- Messages.all(firmware),
        Message.in?(message, version),
        Enum.any?(
          message.request,
          &(match?({:list, _, key, _} when is_atom(key) and key != :rest, &1) or
              match?(%{type: :pstr}, &1))
        ),
        do: {{firmware, version}, message}
  end

  defp sample(layout) do
    for part <- layout, into: %{} do
      case part do
        {:list, key, _count, inner} ->
          {key, for(n <- 0..1, do: Map.new(sample(inner), fn {k, _} -> {k, n} end))}

        %{key: key, type: :pstr} ->
          {key, "ab"}

        %{key: key, type: {:text, 1}} ->
          {key, ""}

        %{key: key, type: {_kind, size}} ->
          {key, :binary.copy("a", size - 1)}

        %{key: key} ->
          {key, 1}
      end
    end
  end

  test "a write that says how long it is has that length, neither less nor more, and no list is empty" do
    assert length(announcing()) > 30

    for {{_firmware, version} = target, message} <- announcing() do
      {:ok, payload} = Payload.encode(message.request, sample(message.request), version)
      assert {:ok, _} = check(message.id, payload, target: target), message.name
      assert refused(message.id, payload <> <<0>>, target: target) =~ message.name

      for size <- 0..(byte_size(payload) - 1),
          do: assert(refused(message.id, binary_part(payload, 0, size), target: target) =~ message.name)

      # A count of one more, one less, and of 0.
      for {:list, key, count, _} <- message.request, is_atom(count), list <- [[], nil, 1] do
        values = sample(message.request)
        entries = if list == 1, do: tl(values[key]), else: list

        {:ok, less} =
          Payload.encode(message.request, Map.merge(values, %{key => entries || [], count => 0}), version)

        tail = binary_part(payload, byte_size(less), byte_size(payload) - byte_size(less))
        more = if list == nil, do: "", else: tail
        assert refused(message.id, less <> more, target: target) =~ message.name
      end
    end
  end

  test "4.5.5 ended by an order of no motors, and took one whose outputs it does not have" do
    for payload <- [
          <<0>>,
          <<0, 48, 2, 0, 100>>,
          <<4, 0, 1, 2>>,
          <<4, 0, 1, 2, 4>>,
          <<4, 0, 1, 1, 2>>,
          <<9, 0, 1, 2, 3, 4, 5, 6, 7, 8>>
        ],
        do: assert(refused(0x3002, payload) =~ "MOTOR_OUTPUT_REORDERING")

    assert {:ok, _} = check(0x3002, <<4, 3, 1, 0, 2>>)
    # By its count the firmware divides.
    assert refused(0x100A, <<0, 1, 0::64>>) =~ "SERIAL_CONFIG"
  end

  test "SET_OSD_CONFIG is as long as its first byte says" do
    for {payload, ok?} <- [
          {<<-1, 0::64>>, false},
          {<<-1, 0::72>>, true},
          {<<-2, 0, 0, 0>>, true},
          {<<-2, 0, 0>>, false},
          {<<5, 0, 0>>, true},
          {<<5, 0, 0, 1>>, true},
          {<<5, 0>>, false}
        ],
        do: assert(match?({:ok, _}, check(85, payload)) == ok?)
  end

  test "what moves channels is marked, in each firmware" do
    for {firmware, names} <- [betaflight: ["SET_RAW_RC"], inav: ["MSP2_INAV_SET_AUX_RC", "SET_RAW_RC"]] do
      marked = for %{channels?: true, name: name} <- Messages.all(firmware), do: name
      assert Enum.sort(marked) == names
      # Nothing else of that name writes.
      assert for(%{kind: :write, name: name} <- Messages.all(firmware), name =~ ~r/(RAW|AUX)_RC/, do: name)
             |> Enum.sort() == names
    end
  end

  test "MULTIPLE_MSP names telemetry only: 4.5.5 set all PIDs to 0 by [202]" do
    assert {:ok, _} = check(230, <<150, 108, 109, 106, 130>>)

    for id <- [202, 250, 68, 230, 52, 84, 116, 119, 137, 0],
        do: assert(refused(230, <<108, id>>) =~ "only telemetry")

    assert refused(230, "") =~ "names no message"
    assert refused(230, :binary.copy(<<150>>, 9)) =~ "more than 250"
    assert refused(230, <<108>>, target: {:inav, {9, 0}}) =~ "not known"
  end

  test "what leaves MSP, or cannot be undone, is never sent" do
    assert refused(245, <<255>>) =~ "leaves MSP"
    assert refused(245, <<255>>, target: {:inav, {9, 0}}) =~ "leaves MSP"
    for mode <- 1..4, do: assert(refused(68, <<mode>>) =~ "boot loader")
    assert refused(68, <<1>>, target: {:inav, {9, 0}}) =~ "boot loader"
    for payload <- ["", <<0>>], do: assert({:ok, _} = check(68, payload))
    assert refused(188, <<60, 22>>) =~ "restarts the vehicle"
    assert refused(0x3012, "defaults", target: {:betaflight, {1, 49}}) =~ "can do anything"
    for id <- [248, 249], do: assert(refused(id, "x") =~ "once only")
    assert refused(0x3003, <<1, 255, 1, 21>>) =~ "turns motors"
  end

  test "what is in no table, or in that of another version or firmware, may be a write" do
    assert refused(0x4242) =~ "not known"
    assert refused(0x3010, "p_roll") =~ "not known"
    assert {:ok, _} = check(0x3010, "p_roll", target: {:betaflight, {1, 48}})
    assert refused(0x100A, :binary.copy(<<1>>, 10), target: {:betaflight, {1, 49}}) =~ "not known"
    assert refused(0x2000) =~ "not known"
  end

  test "no reply goes to a flight controller" do
    for direction <- [:reply, :error] do
      assert {:error, "it is not a request"} =
               Guard.check(%Frame{id: 1, direction: direction}, {:betaflight, nil})
    end
  end

  test "any frame is let through as a message of the table, or refused with a reason" do
    property =
      :proper.forall({frame(), :proper_types.oneof(Messages.firmwares())}, fn {frame, firmware} ->
        case Guard.check(frame, {firmware, nil}) do
          {:ok, message} ->
            message.id == frame.id and byte_size(frame.payload) <= 192 and message.never == nil

          {:error, why} ->
            String.printable?(why)
        end
      end)

    assert :proper.quickcheck(property, [:quiet, {:numtests, 500}]) == true
  end

  test "no message that MULTIPLE_MSP may name asks for something, or is longer than said" do
    for {id, size} <- Guard.multiple() do
      assert {:ok, %{kind: :read, request: []}} = Messages.fetch(:betaflight, id)
      assert size < 255
    end
  end
end
