defmodule MavRouter.Endpoints.Queue.RequestedDataTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  import :proper_types, only: [list: 1, elements: 1, range: 2, oneof: 1]

  alias MavRouter.Router
  alias MavRouter.Endpoints.Queue.RequestedData
  alias MavRouter.Endpoints.Queue.ClassQueue
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @patience Aerie.Patience.ms()
  # 3 MB.
  @pieces 33_334

  defp request,
    do:
      MavCodec.encode(%M.LogRequestData{target_system: 1, target_component: 1, count: 4_294_967_295},
        system: 255,
        component: 190
      )

  defp piece(n),
    do:
      MavCodec.encode(%M.LogData{id: 1, ofs: n * 90, count: 90, data: String.duplicate("x", 90)},
        system: 1,
        component: 1,
        seq: rem(n, 256)
      )

  defp frame(bytes), do: MavCodec.Frame.from_bytes(bytes, nil)

  describe "through a gateway" do
    setup do
      gateway = start_parts(%{mavlink: %{system_id: 245, component_id: 191}})
      {_id, port} = add_link(gateway, "tcpin:127.0.0.1:0", id: "radio")
      vehicle = connect(port)
      :ok = :gen_tcp.send(vehicle, heartbeat(1))
      eventually(fn -> Router.route(gateway, {"main", 1}) end)
      {:ok, "gcs"} = MavRouter.Client.add(gateway, %{url: "tcpin:127.0.0.1:0", id: "gcs"})
      {:ok, gateway: gateway, vehicle: vehicle, port: snapshot(gateway, "gcs").port}
    end

    # Little beside the log, but more than a segment of loopback (64 KiB). With less, a reader that goes on after a while
    # waits for the sender's next probe, and probes are as far apart as the reader has been slow.
    defp connect(port, options \\ [recbuf: 262_144]) do
      {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false] ++ options)
      socket
    end

    defp client(c, system) do
      socket = connect(c.port)
      :ok = :gen_tcp.send(socket, heartbeat(system, type: 6, autopilot: 8, component: 190))
      eventually(fn -> Router.route(c.gateway, {"main", system}) end)
      socket
    end

    defp hears(socket, bytes, before \\ "") do
      {:ok, got} = :gen_tcp.recv(socket, 0, @patience)
      if :binary.match(before <> got, bytes) == :nomatch, do: hears(socket, bytes, before <> got), else: :ok
    end

    # The offsets of LOG_DATA in what is read until the last one has come.
    defp pieces(socket, bytes, parser \\ Parser.new(), offsets \\ []) do
      {frames, parser} = Parser.push(parser, bytes, 0)
      new = for %{id: 120} = frame <- frames, {:ok, data} = MavCodec.decode(frame), do: div(data.ofs, 90)
      offsets = Enum.reverse(new) ++ offsets

      if List.first(offsets) == @pieces - 1 do
        Enum.reverse(offsets)
      else
        {:ok, bytes} = :gen_tcp.recv(socket, 0, @patience)
        pieces(socket, bytes, parser, offsets)
      end
    end

    test "a log of 3 MB arrives whole at a client that reads slower than the vehicle sends; another client's loss is counted",
         c do
      # Made before anybody waits: the connection of a client that takes nothing for ten seconds is ended.
      chunks =
        for chunk <- Enum.chunk_every(0..(@pieces - 1), 500) do
          Enum.map(chunk, &[piece(&1), if(rem(&1, 10) == 0, do: attitude(1, &1), else: [])])
        end

      [asks, _looks_on] = for system <- [255, 254], do: client(c, system)
      :ok = :gen_tcp.send(asks, request())
      hears(c.vehicle, request())

      # The other client reads nothing, and this one less than half of what comes before the vehicle is done.
      read =
        for chunk <- chunks, into: "" do
          :ok = :gen_tcp.send(c.vehicle, chunk)
          {:ok, bytes} = :gen_tcp.recv(asks, 24_576, @patience)
          bytes
        end

      assert pieces(asks, read) == Enum.to_list(0..(@pieces - 1))
      assert dropped(c, asks) == 0
      eventually(fn -> snapshot(c.gateway, "gcs").counters.dropped_out > 0 end)
    end
  end

  defp dropped(c, socket) do
    {:ok, {_address, port}} = :inet.sockname(socket)

    Enum.find_value(Router.endpoints(c.gateway), 0, fn client ->
      client.peer == "127.0.0.1:#{port}" && client.counters.dropped_bulk
    end)
  end

  describe "the queue" do
    defp asking(options \\ []) do
      {true, queue} = ClassQueue.request(ClassQueue.new(options), [frame(request())], 0)
      queue
    end

    defp pops(queue, now) do
      case ClassQueue.pop(queue, now) do
        nil -> []
        {{_class, frame}, queue} -> [frame | pops(queue, now)]
      end
    end

    test "what was asked for takes turns with telemetry, and waits for commands only" do
      {queue, %{}} = ClassQueue.push(asking(), :state, ["t1", "t2", "t3"], 1)
      {queue, %{}} = ClassQueue.push(queue, :bulk, [piece(1), piece(2)], 1)
      {queue, %{}} = ClassQueue.push(queue, :control, ["c"], 1)
      assert pops(queue, 2) == ["c", piece(1), "t1", piece(2), "t2", "t3"]
    end

    test "its room is its own: telemetry takes none of it, and it takes none of telemetry's" do
      queue = asking(max_frames: 2, max_asked: 3 * byte_size(piece(1)))
      {queue, dropped} = ClassQueue.push(queue, :bulk, Enum.map(1..5, &piece/1), 1)
      assert dropped == %{bulk: 2}
      {queue, dropped} = ClassQueue.push(queue, :state, ["t1", "t2", "t3"], 1)
      assert dropped == %{state: 1}
      # What came first is whole.
      assert Enum.filter(pops(queue, 1), &(byte_size(&1) > 2)) == Enum.map(1..3, &piece/1)
    end

    test "what nobody asked for, or long ago, is like any other" do
      {queue, dropped} = ClassQueue.push(ClassQueue.new(max_frames: 2), :bulk, Enum.map(1..5, &piece/1), 0)
      assert {dropped, queue.frames} == {%{bulk: 3}, 2}

      {_queue, dropped} =
        ClassQueue.push(asking(max_frames: 2), :bulk, Enum.map(1..5, &piece/1), RequestedData.lasts_ms())

      assert dropped == %{bulk: 3}
      # An answer keeps it asked for, whether it waited or not.
      queue = ClassQueue.passed(asking(max_frames: 2), :bulk, [piece(1)], RequestedData.lasts_ms() - 1)

      assert {_queue, none} =
               ClassQueue.push(queue, :bulk, Enum.map(1..5, &piece/1), RequestedData.lasts_ms() + 1)

      assert none == %{}
    end

    test "within what was asked for nothing is overtaken; all is within its bounds" do
      step = oneof([{:push, elements([:state, :bulk, :control]), range(1, 40)}, :pop])

      property =
        :proper.forall(list(step), fn steps ->
          {queue, sent, got} =
            Enum.reduce(Enum.with_index(steps), {asking(max_frames: 10, max_asked: 1_000), [], []}, fn
              {{:push, :bulk, n}, i}, {queue, sent, got} ->
                frames = for k <- 1..n, do: piece(i * 100 + k)
                {queue, dropped} = ClassQueue.push(queue, :bulk, frames, 0)
                {queue, sent ++ Enum.take(frames, n - Map.get(dropped, :bulk, 0)), got}

              {{:push, class, n}, i}, {queue, sent, got} ->
                {queue, _dropped} = ClassQueue.push(queue, class, List.duplicate("#{i}", n), 0)
                {queue, sent, got}

              {:pop, _i}, {queue, sent, got} ->
                case ClassQueue.pop(queue, 0) do
                  {{:transfer, frame}, queue} -> {queue, sent, got ++ [frame]}
                  {_other, queue} -> {queue, sent, got}
                  nil -> {queue, sent, got}
                end
            end)

          depth = queue.waiting |> Map.values() |> Enum.map(&:queue.len/1) |> Enum.sum()

          queue.requested.bytes <= 1_000 and queue.frames == depth + queue.requested.frames and depth <= 10 and
            List.starts_with?(sent, got)
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
    end
  end
end
