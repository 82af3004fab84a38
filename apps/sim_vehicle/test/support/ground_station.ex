defmodule SimVehicle.GroundStation do
  @moduledoc """
  What a ground station does with a vehicle over a link that may lose frames: it asks again until it is answered. It works on a
  `SimVehicle.Peer`; every function returns what it got, and the peer.
  """

  import ExUnit.Callbacks, only: [start_supervised!: 2]

  alias MavCodec.{Ftp.Packet, Messages}
  alias MavCodec.Messages, as: M
  alias SimVehicle.Peer

  @again_ms 100
  @params [:param1, :param2, :param3, :param4, :param5, :param6, :param7]

  @doc "A vehicle that sends to a new station, when its position is good."
  def start(firmware, options \\ []) do
    peer = Peer.udp()

    options =
      Keyword.merge(
        [firmware: firmware, link: "udpout:127.0.0.1:#{Peer.port(peer)}", ready_s: 2.0, speed: 10],
        options
      )

    sim = start_supervised!({SimVehicle, options}, id: make_ref())
    SimVehicle.await(sim, & &1.ready)
    {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
    {sim, peer}
  end

  @doc "Sends a message until an answer comes of which `fun` is true."
  def ask(peer, message, answer, fun \\ fn _answer -> true end, until \\ nil) do
    until = until || now() + Application.fetch_env!(:ex_unit, :assert_receive_timeout)

    case peer |> Peer.say(target(message)) |> Peer.within(answer, fun, now() + @again_ms) do
      {nil, peer} ->
        if now() > until,
          do: raise("no #{inspect(answer)} came"),
          else: ask(peer, message, answer, fun, until)

      found ->
        found
    end
  end

  @doc "The result of a COMMAND_LONG. Its acknowledgements of before are forgotten."
  def command(peer, id, params \\ [], fields \\ []) do
    message = struct!(M.CommandLong, [command: id] ++ Enum.zip(@params, params) ++ fields)
    {ack, peer} = peer |> Peer.forget(M.CommandAck) |> ask(message, M.CommandAck, &(&1.command == id))
    {ack.result, peer}
  end

  @doc "Arms and takes off to `height` metres above home."
  def fly(sim, peer, height \\ 20) do
    %{home: home} = SimVehicle.state(sim)
    px4? = match?(%{mode: "AUTO" <> _rest}, SimVehicle.state(sim))
    {0, peer} = if px4?, do: {0, peer}, else: command(peer, 176, [1.0, 4.0])
    {0, peer} = command(peer, 400, [1.0])
    alt = if px4?, do: home.alt + height, else: height
    nan = if px4?, do: :nan, else: 0.0
    {0, peer} = command(peer, 22, [0.0, 0.0, 0.0, nan, nan, nan, alt * 1.0])
    SimVehicle.await(sim, &(&1.alt_rel > height - 1))
    peer
  end

  @doc "Uploads a plan; the type of the final MISSION_ACK."
  def upload(peer, items, type \\ 0) do
    count = %M.MissionCount{count: length(items), mission_type: type}

    peer =
      peer |> Peer.forget(M.MissionAck) |> Peer.forget(M.MissionRequest) |> Peer.forget(M.MissionRequestInt)

    answer_requests(peer, Enum.map(items, &Map.put(&1, :mission_type, type)), {count, 0}, count)
  end

  # The vehicle asks again for an item that was lost. If it does so no more, its acknowledgement was lost: from the beginning.
  defp answer_requests(peer, items, {_message, silent}, count) when silent > 5,
    do: answer_requests(peer, items, {count, 0}, count)

  defp answer_requests(peer, items, {message, silent}, count) do
    kinds = [M.MissionRequest, M.MissionRequestInt, M.MissionAck]

    case peer |> Peer.say(target(message)) |> Peer.within(kinds, fn _any -> true end, now() + @again_ms) do
      {nil, peer} ->
        answer_requests(peer, items, {message, silent + 1}, count)

      # Out of sequence: an item came twice, and the upload goes on (AP_Mission).
      {%M.MissionAck{type: 13}, peer} ->
        answer_requests(peer, items, {message, silent}, count)

      # ArduPilot has no upload under way: it is over, and its acknowledgement was lost.
      {%M.MissionAck{type: 1}, peer} ->
        answer_requests(peer, items, {count, 0}, count)

      {%M.MissionAck{type: type}, peer} ->
        {type, peer}

      {%{seq: seq}, peer} ->
        fields = items |> Enum.at(seq) |> Map.merge(%{seq: seq, autocontinue: 1})
        answer_requests(peer, items, {struct!(M.MissionItemInt, fields), 0}, count)
    end
  end

  @doc "Downloads a plan."
  def download(peer, type \\ 0) do
    mine = &(&1.mission_type == type)
    {%{count: count}, peer} = ask(peer, %M.MissionRequestList{mission_type: type}, M.MissionCount, mine)

    Enum.map_reduce(0..(count - 1)//1, peer, fn seq, peer ->
      request = %M.MissionRequestInt{seq: seq, mission_type: type}
      ask(peer, request, M.MissionItemInt, &(mine.(&1) and &1.seq == seq))
    end)
  end

  @doc "The value of a parameter, as it is on the wire."
  def param(peer, name) do
    read = %M.ParamRequestRead{param_index: -1, param_id: name}
    {value, peer} = peer |> Peer.forget(M.ParamValue) |> ask(read, M.ParamValue, &(&1.param_id == name))
    {value.param_value, peer}
  end

  @doc "Sets a parameter, and returns what the vehicle then says that it is."
  def set_param(peer, name, value, type) do
    set = %M.ParamSet{param_id: name, param_value: value, param_type: type}
    {value, peer} = peer |> Peer.forget(M.ParamValue) |> ask(set, M.ParamValue, &(&1.param_id == name))
    {value.param_value, peer}
  end

  @doc "The answer to an FTP request: `{:ack | :nak, packet}`."
  def ftp(peer, operation, fields) do
    seq = fields[:seq] || peer.seq * 3
    fields = [seq: seq, opcode: Packet.opcode(operation), size: byte_size(fields[:data] || "")] ++ fields
    message = %M.FileTransferProtocol{payload: Packet.encode(struct!(Packet, fields))}
    answers? = &match?({_kind, %{seq: at}} when at == seq + 1, Packet.answer(&1))

    {answer, peer} =
      peer |> Peer.forget(M.FileTransferProtocol) |> ask(message, M.FileTransferProtocol, answers?)

    {Packet.answer(answer), peer}
  end

  @doc "Reads a file to its end, piece by piece."
  def read_file(peer, path) do
    {{:ack, %{session: session}}, peer} = ftp(peer, :open, data: path)
    {bytes, peer} = pieces(peer, session, "")
    {{:ack, _ended}, peer} = ftp(peer, :terminate, session: session)
    {bytes, peer}
  end

  defp pieces(peer, session, bytes) do
    case ftp(peer, :read, session: session, offset: byte_size(bytes), size: Packet.max_data()) do
      # The end of a file that is made while it is read lies at no multiple of the size of the reads.
      {{:ack, %{size: size, data: data}}, peer} when size < 239 -> {bytes <> data, peer}
      {{:ack, %{data: data}}, peer} -> pieces(peer, session, bytes <> data)
      {{:nak, nak}, peer} -> {if(Packet.error(nak) == :eof, do: bytes), peer}
    end
  end

  @doc "Bytes of a log from an offset on; what is lost is requested again."
  def log(peer, id, size) do
    {pieces, peer} = log_pieces(peer, id, size, %{})
    {pieces |> Enum.sort() |> Enum.map_join(&elem(&1, 1)), peer}
  end

  defp log_pieces(peer, id, size, got) do
    case Enum.find(0..(size - 1)//90, &(not is_map_key(got, &1))) do
      nil ->
        {got, peer}

      offset ->
        request = %M.LogRequestData{id: id, ofs: offset, count: size - offset}
        {piece, peer} = ask(peer, request, M.LogData, &(&1.id == id and &1.ofs >= offset))
        {more, peer} = Peer.collect(peer, M.LogData, &(&1.ofs + &1.count >= size), now() + @again_ms)
        got = for m <- [piece | more], m.id == id, into: got, do: {m.ofs, binary_part(m.data, 0, m.count)}
        log_pieces(peer, id, size, got)
    end
  end

  @doc "Waits until the vehicle's heartbeat shows a state of MAV_STATE."
  def await_status(peer, status) do
    {_heartbeat, peer} =
      peer |> Peer.forget(M.Heartbeat) |> Peer.await(M.Heartbeat, &(&1.system_status == status))

    peer
  end

  @doc "Waits for a text that begins so."
  def await_text(peer, text) do
    {_text, peer} = Peer.await(peer, M.Statustext, &String.starts_with?(&1.text, text))
    peer
  end

  @doc "An item of a mission with a place; heights are above home."
  def item(command, north \\ 0, fields \\ %{}),
    do:
      Map.merge(
        %{command: command, frame: 3, x: -353_632_610 + north * 90, y: 1_491_652_300, z: 20.0},
        fields
      )

  defp target(%Messages.Heartbeat{} = message), do: message
  defp target(message), do: Map.merge(message, %{target_system: 1, target_component: 1})

  defp now, do: System.monotonic_time(:millisecond)
end
