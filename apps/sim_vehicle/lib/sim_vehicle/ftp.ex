defmodule SimVehicle.Ftp do
  @moduledoc """
  The MAVLink FTP server of a vehicle, as a value: `handle/4` gives it a request and returns its answers.

  It is as strict as the firmwares are. PX4 has one session and refuses to open another; ArduPilot has five, and reads its
  generated parameter file in pieces of one size only. A request with the number of the one before gets the last answer again
  (T2). Sessions do not survive a reboot; files do.
  """

  alias SimVehicle.Params
  alias SimVehicle.Ftp.Pack

  @max_data 239
  @burst_packets 60
  @burst_us 1_000
  @sessions %{px4: 1, ardupilot: 5}
  @max_file 4_000_000
  @max_files 100

  @ack 128
  @nak 129
  @fail 1
  @errno 2
  @invalid_session 4
  @no_sessions 5
  @eof 6
  @unknown 7
  @not_found 10

  defstruct style: :ardupilot, files: %{}, sessions: %{}, last: nil

  @typedoc "`files`: content by path; `sessions`: what is open, by number; `last`: the last request and its answer"
  @type t :: %__MODULE__{}
  @type answer :: {after_us :: non_neg_integer, payload :: binary}

  @doc "A server with files, `%{path => content}`."
  @spec new(:ardupilot | :px4, %{String.t() => binary}) :: t
  def new(style, files \\ %{}), do: %__MODULE__{style: style, files: files}

  @doc "All sessions are lost."
  @spec reboot(t) :: t
  def reboot(ftp), do: %{ftp | sessions: %{}, last: nil}

  @doc "The server after a request of `source`, and the answers with the time that each takes."
  @spec handle(t, binary, term, Params.t()) :: {t, [answer]}
  def handle(%{last: {source, payload, answer}} = ftp, payload, source, _params), do: {ftp, [{0, answer}]}

  def handle(
        ftp,
        <<seq::little-16, session, opcode, size, _request, _complete, _padding, offset::little-32,
          data::binary>> = payload,
        source,
        params
      )
      when size <= @max_data do
    request = %{
      seq: seq,
      session: session,
      opcode: opcode,
      size: size,
      offset: offset,
      data: binary_part(data, 0, min(size, byte_size(data))),
      params: params
    }

    {ftp, answers} = on(ftp, opcode, request)

    answers =
      for {{kind, fields}, n} <- Enum.with_index(answers),
          do: {n * @burst_us, answer(request, kind, fields, n)}

    case answers do
      [{_now, only}] when opcode != 15 -> {%{ftp | last: {source, payload, only}}, answers}
      _burst -> {%{ftp | last: nil}, answers}
    end
  end

  def handle(ftp, _malformed, _source, _params), do: {ftp, []}

  # --- sessions ---

  defp on(ftp, 1, r), do: {%{ftp | sessions: Map.delete(ftp.sessions, r.session)}, [ack()]}
  defp on(ftp, 2, _r), do: {%{ftp | sessions: %{}}, [ack()]}

  # --- directories ---

  defp on(ftp, 3, r) do
    folder = "/" <> String.trim(r.data, "/")

    entries =
      ftp
      |> paths()
      |> Enum.flat_map(&entry(&1, String.trim_trailing(folder, "/") <> "/"))
      |> Enum.uniq()
      |> Enum.drop(r.offset)

    {ftp, [if(entries == [], do: nak(@eof), else: ack(data: fitting(entries)))]}
  end

  # --- opening ---

  defp on(ftp, 4, r) do
    case content(ftp, r.data, r.params) do
      nil -> {ftp, [nak(@not_found)]}
      bytes -> open(ftp, %{path: r.data, bytes: bytes, write?: false, piece: nil}, told_size(r.data, bytes))
    end
  end

  defp on(%{files: files} = ftp, opcode, r) when opcode in [6, 11] do
    cond do
      String.starts_with?(r.data, "@") ->
        {ftp, [nak(@fail)]}

      opcode == 11 and not is_map_key(files, r.data) ->
        {ftp, [{:nak, [data: <<@errno, 2>>]}]}

      map_size(files) >= @max_files and not is_map_key(files, r.data) ->
        {ftp, [{:nak, [data: <<@errno, 28>>]}]}

      true ->
        write_open(ftp, r, if(opcode == 6, do: "", else: files[r.data]))
    end
  end

  # --- contents ---

  defp on(ftp, 5, r) do
    with_session(ftp, r, fn ftp, file ->
      case piece(ftp, file, r) do
        {:ok, ftp, ""} -> {ftp, [nak(@eof) |> at(r)]}
        {:ok, ftp, bytes} -> {ftp, [ack(data: bytes) |> at(r)]}
        :error -> {ftp, [{:nak, [data: <<@errno, 22>>]}]}
      end
    end)
  end

  defp on(ftp, 7, r) do
    with_session(ftp, r, fn ftp, file ->
      if file.write? and r.offset + byte_size(r.data) <= @max_file do
        old = Map.get(ftp.files, file.path, "")
        {ftp, [ack(size: byte_size(r.data)) |> at(r)]} |> put_file(file.path, splice(old, r.offset, r.data))
      else
        {ftp, [nak(@fail)]}
      end
    end)
  end

  defp on(ftp, 8, r) do
    if is_map_key(ftp.files, r.data),
      do: {%{ftp | files: Map.delete(ftp.files, r.data)}, [ack()]},
      else: {ftp, [{:nak, [data: <<@errno, 2>>]}]}
  end

  defp on(ftp, 14, r) do
    case content(ftp, r.data, r.params) do
      nil -> {ftp, [nak(@not_found)]}
      bytes -> {ftp, [ack(data: <<crc32(bytes)::little-32>>)]}
    end
  end

  defp on(ftp, 15, r), do: with_session(ftp, r, &burst(&1, &2, r, 0, []))
  defp on(ftp, _opcode, _r), do: {ftp, [nak(@unknown)]}

  defp burst(ftp, _file, _r, @burst_packets, [{:ack, fields} | before]),
    do: {ftp, Enum.reverse([{:ack, [complete: 1] ++ fields} | before])}

  # ArduPilot ends with a short packet, PX4 with EOF.
  defp burst(ftp, file, r, n, answers) do
    case piece(ftp, file, r) do
      {:ok, ftp, ""} ->
        {ftp, Enum.reverse([nak(@eof) |> at(r) | answers])}

      {:ok, %{style: :ardupilot} = ftp, bytes} when byte_size(bytes) < r.size ->
        {ftp, Enum.reverse([ack(data: bytes, complete: 1) |> at(r) | answers])}

      {:ok, ftp, bytes} ->
        burst(ftp, file, %{r | offset: r.offset + byte_size(bytes)}, n + 1, [
          ack(data: bytes) |> at(r) | answers
        ])

      :error ->
        {ftp, [{:nak, [data: <<@errno, 22>>]}]}
    end
  end

  # The generated file: pieces of one size, at multiples of it.
  defp piece(ftp, %{path: "@" <> _generated} = file, r) do
    size = file.piece || r.size

    if r.size == size and rem(r.offset, size) == 0,
      do: {:ok, put_session(ftp, r.session, %{file | piece: size}), slice(file.bytes, r)},
      else: :error
  end

  defp piece(ftp, file, r), do: {:ok, ftp, slice(file.bytes, r)}

  defp slice(bytes, r) when r.offset >= byte_size(bytes), do: ""
  defp slice(bytes, r), do: binary_part(bytes, r.offset, min(r.size, byte_size(bytes) - r.offset))

  defp splice(old, offset, data) do
    gap = max(offset - byte_size(old), 0)
    head = binary_part(old, 0, min(offset, byte_size(old)))
    rest = offset + byte_size(data)
    tail = if byte_size(old) > rest, do: binary_part(old, rest, byte_size(old) - rest), else: ""
    head <> <<0::size(gap * 8)>> <> data <> tail
  end

  defp put_file({ftp, answers}, path, bytes), do: {%{ftp | files: Map.put(ftp.files, path, bytes)}, answers}

  # PX4 uses session 0 alone.
  defp open(ftp, file, size) do
    case Enum.find(0..(@sessions[ftp.style] - 1), &(not is_map_key(ftp.sessions, &1))) do
      nil -> {ftp, [nak(@no_sessions)]}
      session -> {put_session(ftp, session, file), [ack(session: session, data: <<size::little-32>>)]}
    end
  end

  defp write_open(ftp, r, bytes) do
    {after_open, [answer]} = open(ftp, %{path: r.data, bytes: "", write?: true, piece: nil}, byte_size(bytes))
    if elem(answer, 0) == :ack, do: put_file({after_open, [answer]}, r.data, bytes), else: {ftp, [answer]}
  end

  defp put_session(ftp, session, file), do: %{ftp | sessions: Map.put(ftp.sessions, session, file)}

  defp with_session(ftp, r, fun) do
    case Map.fetch(ftp.sessions, r.session) do
      {:ok, file} -> fun.(ftp, file)
      :error -> {ftp, [nak(@invalid_session)]}
    end
  end

  # As ArduPilot does: nobody can know the size of what is made while it is read.
  defp told_size("@" <> _generated, _bytes), do: 16_704
  defp told_size(_path, bytes), do: byte_size(bytes)

  defp content(%{style: :ardupilot}, "@PARAM/param.pck" <> query, params) do
    if query in ["", "?withdefaults=1"], do: Pack.file(params, @max_data, query != "")
  end

  defp content(ftp, path, _params), do: ftp.files[path]

  defp paths(ftp),
    do:
      Enum.map(ftp.files, fn {path, bytes} -> {"/" <> String.trim_leading(path, "/"), byte_size(bytes)} end)
      |> Enum.sort()

  defp entry({path, size}, folder) do
    if String.starts_with?(path, folder) do
      case path |> binary_part(byte_size(folder), byte_size(path) - byte_size(folder)) |> String.split("/") do
        [name] -> ["F#{name}\t#{size}"]
        [name | _deeper] -> ["D#{name}"]
      end
    else
      []
    end
  end

  defp fitting(entries) do
    Enum.reduce_while(entries, "", fn entry, data ->
      next = data <> entry <> <<0>>
      if byte_size(next) <= @max_data, do: {:cont, next}, else: {:halt, data}
    end)
  end

  @doc "CRC-32 without inversions."
  @spec crc32(binary) :: non_neg_integer
  def crc32(bytes), do: Bitwise.bxor(:erlang.crc32(0xFFFF_FFFF, bytes), 0xFFFF_FFFF)

  defp ack(fields \\ []), do: {:ack, fields}
  defp nak(code), do: {:nak, [data: <<code>>]}
  defp at({kind, fields}, r), do: {kind, [offset: r.offset] ++ fields}

  defp answer(r, kind, fields, n) do
    data = Keyword.get(fields, :data, "")
    opcode = if kind == :ack, do: @ack, else: @nak
    session = Keyword.get(fields, :session, r.session)
    size = Keyword.get(fields, :size, byte_size(data))
    seq = Bitwise.band(r.seq + 1 + n, 0xFFFF)
    complete = Keyword.get(fields, :complete, 0)
    padding = <<0::size((@max_data - byte_size(data)) * 8)>>

    <<seq::little-16, session, opcode, size, r.opcode, complete, 0,
      Keyword.get(fields, :offset, r.offset)::little-32, data::binary, padding::binary>>
  end
end
