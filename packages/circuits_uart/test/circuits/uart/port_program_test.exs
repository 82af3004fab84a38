defmodule Circuits.UART.PortProgramTest do
  use ExUnit.Case, async: true

  alias Circuits.UART.{Options, PortProgram}
  alias Circuits.UART.Test.Pty

  @moduletag :pty

  test "ends at anything but a request, and says why" do
    for packet <- [
          "",
          "x",
          <<99, 0::32>>,
          <<3, 1::32>>,
          <<1, 1::32, 0::32>>,
          <<8, 1>>,
          <<7, 1::32, 9>>,
          <<4, 1::32, 0>>
        ] do
      command = ["-c", "exec \"$0\" 2>&1", PortProgram.path()]

      port =
        Port.open({:spawn_executable, System.find_executable("sh")}, [:binary, :exit_status, args: command])

      Port.command(port, framed(packet))
      assert_receive {^port, {:data, "circuits_uart: " <> _why}}
      assert_receive {^port, {:exit_status, 2}}
    end
  end

  test "takes packets in any pieces" do
    pty = Pty.open()
    port = Port.open({:spawn_executable, PortProgram.path()}, [:binary])
    requests = [[<<1, 1::32>>, settings(), pty.path], <<3, 2::32, 1_000::32, "hello">>, <<7, 3::32>>]
    for <<byte <- Enum.map_join(requests, &framed/1)>>, do: Port.command(port, <<byte>>)
    assert Pty.read(pty, 5) == "hello"
    answers = for id <- 1..3, into: "", do: <<5::16, ?o, id::32>>
    assert gather(port, byte_size(answers), "") == answers
  end

  # Its end by a signal would be 128 and more.
  test "whatever it is sent, it ends by its own will, with every request before that answered" do
    pty = Pty.open()

    property =
      :proper.forall(:proper_types.list(request(pty.path)), fn requests ->
        requests = for {request, id} <- Enum.with_index(requests), do: numbered(request, id)
        # What comes after its end is read by another program, or the port ends with :epipe.
        port =
          start(~S(exec 3<&0; "$0" 2>/dev/null; s=$?; cat <&3 >/dev/null & exit $s), packet: 2)

        for request <- requests, do: Port.command(port, request)
        Port.command(port, "")
        {status, answered} = await_end(port, MapSet.new())
        # Those that wait for the line when it ends have no answer.
        status == 2 and MapSet.subset?(answered, MapSet.new(0..length(requests)//1))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  defp start(command, options) do
    Port.open(
      {:spawn_executable, System.find_executable("sh")},
      [:binary, :exit_status, args: ["-c", command, PortProgram.path()]] ++ options
    )
  end

  defp request(path) do
    u8 = :proper_types.byte()
    u32 = :proper_types.binary(4)
    bytes = :proper_types.binary()
    noise = :proper_types.binary(5)

    :proper_types.oneof([
      {1, [settings(), path]},
      {1, [settings(), path]},
      {1, [noise, path]},
      {1, [settings(), bytes]},
      {2, noise},
      {2, settings()},
      {3, [<<0::32>>, bytes]},
      {4, <<0::32>>},
      {5, ""},
      {6, <<0::32>>},
      {7, ""},
      # Most of these are no requests: the end comes early.
      :proper_types.weighted_union([{1, {u8, bytes}}, {20, {7, ""}}, {5, {4, u32}}])
    ])
  end

  defp numbered({type, args}, id), do: IO.iodata_to_binary([<<type, id::32>>, args])

  defp await_end(port, answered) do
    receive do
      {^port, {:data, <<kind, id::32, _::binary>>}} when kind in [?o, ?e] ->
        await_end(port, MapSet.put(answered, id))

      {^port, {:data, <<kind, _::binary>>}} when kind in [?d, ?g] ->
        await_end(port, answered)

      {^port, {:exit_status, status}} ->
        {status, answered}
    after
      60_000 -> {:stuck, answered}
    end
  end

  defp framed(packet) do
    packet = IO.iodata_to_binary(packet)
    <<byte_size(packet)::16, packet::binary>>
  end

  defp settings, do: Options.encode(%Options{active: false})

  defp gather(_port, count, sofar) when byte_size(sofar) >= count, do: sofar

  defp gather(port, count, sofar) do
    assert_receive {^port, {:data, bytes}}
    gather(port, count, sofar <> bytes)
  end
end
