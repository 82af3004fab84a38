defmodule Aerie.Control.Params.ResponderTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Params.{Param, Responder, Table}
  alias MavCodec.Message.ParamValue
  alias MavCodec.Ftp.Packet
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @params [%Param{name: "A", value: 5, type: 6}, %Param{name: "B", value: 0.5, type: 9}]
  @table Table.new(@params, hash: 77)
  @list %M.ParamRequestList{target_system: 1}

  defp served(table \\ @table) do
    {served, [:fetch]} = Responder.handle(Responder.new(:bytewise), {:station, @list, :a, 0})
    {served, [{:reply, :a, _all}]} = Responder.handle(served, {:listed, table, @second})
    served
  end

  defp value(name, value, type, more \\ []) do
    {:ok, wire} = ParamValue.encode(value, type, :bytewise)
    struct!(%M.ParamValue{param_id: name, param_value: wire, param_type: type, param_index: 65_535}, more)
  end

  defp read(name, index \\ -1), do: %M.ParamRequestRead{target_system: 1, param_id: name, param_index: index}

  test "stations that ask meanwhile wait for one reading, in the order of the indices, PX4's hash first" do
    {served, [:fetch]} = Responder.handle(Responder.new(:bytewise), {:station, @list, :a, 0})
    {served, []} = Responder.handle(served, {:station, @list, :b, 1})
    {served, []} = Responder.handle(served, {:station, @list, :a, 2})
    {served, [{:reply, :a, all}, {:reply, :b, all}]} = Responder.handle(served, {:listed, @table, @second})

    assert [{"_HASH_CHECK", 65_535}, {"A", 0}, {"B", 1}] = for(m <- all, do: {m.param_id, m.param_index})
    assert Enum.all?(all, &(&1.param_count == 2))
    assert {:ok, 5, true} = ParamValue.decode(Enum.at(all, 1).param_value, 6, :bytewise)
    assert {_served, [{:reply, :c, ^all}]} = Responder.handle(served, {:station, @list, :c, 2 * @second})

    for ask <- [read("B"), read("", 1)],
        do:
          assert(
            {_, [{:reply, :c, [%{param_id: "B"}]}]} =
              Responder.handle(served, {:station, ask, :c, 2 * @second})
          )

    # What it does not know, the vehicle may.
    for ask <- [read("C"), read("", 2)],
        do: assert({_, [{:forward, :c}]} = Responder.handle(served, {:station, ask, :c, 2 * @second}))
  end

  describe "the file" do
    @made Table.new(
            [
              %Param{name: "ACRO_A", value: -5, type: 2, default: 3},
              %Param{name: "ACRO_B", value: 70_000, type: 6, default: 70_000},
              %Param{name: "ACRO_C", value: 0.5, type: 9, default: 1.5},
              %Param{name: "B", value: 300, type: 4, default: nil}
            ] ++ for(n <- 1..200, do: %Param{name: "SERVO#{n}_MIN", value: n, type: 6, default: 0}),
            file_crc: 1
          )
    @path "@PARAM/param.pck"

    defp ftp(opcode, fields) do
      fields = [opcode: Packet.opcode(opcode), size: byte_size(fields[:data] || "")] |> Keyword.merge(fields)
      Packet.message(struct!(Packet, fields), {1, 1})
    end

    defp open(served, path \\ @path, from \\ :a, now \\ 2 * @second),
      do: Responder.handle(served, {:station, ftp(:open, data: path, seq: 1, session: 3), from, now})

    defp read(served, from, size, offset, opcode \\ :read, seq \\ 2) do
      request = ftp(opcode, seq: seq, session: 3, size: size, offset: offset)
      {served, [{:reply, ^from, packets}]} = Responder.handle(served, {:station, request, from, 3 * @second})
      {packets, served}
    end

    defp all(served, from, size, offset \\ 0, read \\ "") do
      case read(served, from, size, offset) do
        {[%{opcode: 128, data: data}], served} ->
          all(served, from, size, offset + byte_size(data), read <> data)

        {[%{opcode: 129, data: <<6>>}], _served} ->
          read
      end
    end

    test "is the list, in reads of any size, no value lying in two; by bursts too" do
      for {path, defaults?} <- [{@path, false}, {@path <> "?withdefaults=1", true}], size <- [239, 110, 80] do
        {served, [{:reply, :a, [%{opcode: 128, request: 4, session: 3, seq: 2}]}]} = open(served(@made), path)
        file = all(served, :a, size)
        assert {:ok, packed} = MavCodec.Ftp.PackedParams.decode(file, 5_000)
        params = Enum.map(packed, &Param.unpack/1)

        for {param, known} <- Enum.zip(params, Enum.map(@made.order, &@made.params[&1])) do
          assert {param.name, param.value, param.type} == {known.name, known.value, known.type}
          assert param.default == if(defaults?, do: known.default || known.value)
        end

        {packets, _served} = read(served, :a, size, 0, :burst)
        assert file |> String.starts_with?(Enum.map_join(packets, & &1.data))
        assert %{complete: true} = List.last(packets)
        assert Enum.map(packets, & &1.seq) == Enum.to_list(3..(length(packets) + 2))
      end
    end

    test "is opened when the list is known, and refused when it may be wrong while it is read" do
      {served, [:fetch]} = open(Responder.new(:c_cast))
      {served, []} = open(served)
      {served, []} = Responder.handle(served, {:station, @list, :b, 1})

      {served, [{:reply, :a, [%{opcode: 128}]}, {:reply, :b, _list}]} =
        Responder.handle(served, {:listed, @made, @second})

      {[first], served} = read(served, :a, 239, 0)
      # A repetition has the same answer (T2); another station, and another session, are the vehicle's.
      assert {[^first], ^served} = read(served, :a, 239, 0)
      other = ftp(:read, session: 3, size: 239)
      assert {_served, [{:forward, :b}]} = Responder.handle(served, {:station, other, :b, 2 * @second})
      other = ftp(:read, session: 4, size: 239)
      assert {_served, [{:forward, :a}]} = Responder.handle(served, {:station, other, :a, 2 * @second})

      {served, _forward} =
        Responder.handle(served, {:station, %M.ParamSet{target_system: 1}, :c, 2 * @second})

      assert {[%{opcode: 129, data: <<1>>}], served} = read(served, :a, 239, 239)
      assert {[%{opcode: 129, data: <<1>>}], served} = read(served, :a, 239, 0)
      assert {[%{opcode: 128, request: 1}], served} = read(served, :a, 0, 0, :terminate, 9)

      assert {served, [{:forward, :a}]} =
               Responder.handle(served, {:station, ftp(:read, session: 3), :a, 2 * @second})

      assert {_served, [:fetch]} = open(served)
    end

    test "of a vehicle without it, other files, and whatever else is the vehicle's business" do
      assert {_served, [{:forward, :a}]} = open(served())
      served = served(@made)

      for message <- [
            ftp(:open, data: "/APM/x"),
            ftp(:open, data: @path <> "?start=5"),
            ftp(:list, data: "@PARAM"),
            ftp(:crc, data: @path),
            ftp(:reset, []),
            %M.FileTransferProtocol{payload: <<1, 2>>}
          ],
          do:
            assert(
              {_served, [{:forward, :a}]} = Responder.handle(served, {:station, message, :a, 2 * @second})
            )

      {served, [{:reply, :a, _ack}]} = open(served)

      for {size, offset} <- [{239, 5}, {0, 0}, {255, 0}],
          do: assert({[%{opcode: 129}], _s} = read(served, :a, size, offset))

      served = Enum.reduce(1..64, served, fn n, served -> elem(open(served, @path, n), 0) end)
      assert {_served, [{:forward, 65}]} = open(served, @path, 65)
    end
  end

  test "a list that was read while a station set a parameter is read again, whether or not the vehicle's answer is heard" do
    {served, [:fetch]} = Responder.handle(Responder.new(:bytewise), {:station, @list, :a, 0})
    set = %M.ParamSet{target_system: 1, param_id: "A"}
    {served, [{:forward, :b}]} = Responder.handle(served, {:station, set, :b, 1})
    # An older answer comes late.
    {served, []} = Responder.handle(served, {:vehicle, value("A", 5, 6), 2})
    {served, [:fetch]} = Responder.handle(served, {:listed, @table, @second})
    assert {_served, [{:reply, :a, _all}]} = Responder.handle(served, {:listed, @table, 2 * @second})
  end

  test "nothing is given that may be another value" do
    for event <- [
          {:station, %M.ParamSet{target_system: 1, param_id: "A"}, :b, 2 * @second},
          {:vehicle, value("A", 6, 6), 2 * @second},
          {:vehicle, value("NEW", 6, 6), 2 * @second},
          {:vehicle, value("_HASH_CHECK", 78, 5), 2 * @second},
          {:rebooted, 2 * @second}
        ] do
      {served, _forward} = Responder.handle(served(), event)
      refute Responder.fresh?(served, 2 * @second)
      assert {_served, [{:forward, :a}]} = Responder.handle(served, {:station, read("A"), :a, 2 * @second})
      assert {_served, [:fetch]} = Responder.handle(served, {:station, @list, :a, 2 * @second})
    end

    # After a while it is checked again.
    assert {_served, [:fetch]} = Responder.handle(served(), {:station, @list, :a, 7 * @second})
    # The vehicle says the same: nothing changes, and its hash shows that all is right.
    {served, []} = Responder.handle(served(), {:vehicle, value("A", 5, 6), 2 * @second})
    {served, []} = Responder.handle(served, {:vehicle, value("_HASH_CHECK", 77, 5), 5 * @second})
    assert Responder.fresh?(served, 9 * @second)
  end

  test "a value that came while the list was read decides: it is read once more, and then the vehicle answers itself" do
    {served, [:fetch]} = Responder.handle(Responder.new(:bytewise), {:station, @list, :a, 0})
    {served, []} = Responder.handle(served, {:vehicle, value("A", 5, 6), 1})
    {served, []} = Responder.handle(served, {:vehicle, value("B", 0.75, 9), 2})
    {again, [:fetch]} = Responder.handle(served, {:listed, @table, @second})
    assert {_served, [{:reply, :a, _all}]} = Responder.handle(again, {:listed, @table, 2 * @second})
    {again, []} = Responder.handle(again, {:vehicle, value("B", 0.8, 9), 2 * @second})
    assert {served, [{:forward, :a}]} = Responder.handle(again, {:listed, @table, 3 * @second})
    refute Responder.fresh?(served, 3 * @second)
    {served, [:fetch]} = Responder.handle(Responder.new(:bytewise), {:station, @list, :a, 0})
    assert {_served, [{:forward, :a}]} = Responder.handle(served, {:unlisted, @second})
  end

  test "bounds the stations that wait" do
    {served, [:fetch]} = Responder.handle(Responder.new(:bytewise), {:station, @list, 0, 0})

    served =
      Enum.reduce(1..63, served, fn n, served ->
        served |> Responder.handle({:station, @list, n, 0}) |> elem(0)
      end)

    assert {_served, [{:forward, 64}]} = Responder.handle(served, {:station, @list, 64, 0})
  end
end
