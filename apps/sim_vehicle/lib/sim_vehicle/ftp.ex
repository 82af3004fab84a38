defmodule SimVehicle.Ftp do
  @moduledoc """
  The MAVLink FTP server of a vehicle, as a value: `handle/4` gives it a request and returns its answers.

  It is as strict as the firmwares are. PX4 has one session and refuses to open another; ArduPilot has five, and reads its
  generated parameter file in pieces of one size only. A request with the number of the one before gets the last answer again
  (T2). Sessions do not survive a reboot; files do.
  """

  alias MavCodec.CRC
  alias MavCodec.Ftp.PackedParams
  alias MavCodec.Ftp.Packet
  alias Protocols.Files.Content
  alias SimVehicle.Params

  @max_data Packet.max_data()
  @burst_us 1_000
  @sessions %{px4: 1, ardupilot: 5}
  # How a burst ends.
  @ending %{px4: :eof, ardupilot: :short}
  @max_file 4_000_000
  @max_files 100

  # Whether the parameter file has defaults, by its path.
  @packed Map.new([false, true], &{PackedParams.path(&1), &1})
  @enoent {:errno, 2}
  @einval {:errno, 22}
  @enospc {:errno, 28}

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

  def handle(ftp, payload, source, params) do
    case Packet.decode(payload) do
      {:ok, %{size: size} = request} when size <= @max_data ->
        {ftp, answers} = on(ftp, Packet.operation(request), request, params)

        payloads = Enum.map(answers, &Packet.encode/1)
        last = if match?([_only], payloads) and not burst?(request), do: {source, payload, hd(payloads)}
        {%{ftp | last: last}, Enum.with_index(payloads, &{&2 * @burst_us, &1})}

      _malformed ->
        {ftp, []}
    end
  end

  defp burst?(request), do: Packet.operation(request) == :burst

  # --- sessions ---

  defp on(ftp, :terminate, r, _params),
    do: {%{ftp | sessions: Map.delete(ftp.sessions, r.session)}, [Packet.ack(r, "")]}

  defp on(ftp, :reset, r, _params), do: {%{ftp | sessions: %{}}, [Packet.ack(r, "")]}

  # --- directories ---

  defp on(ftp, :list, r, _params) do
    folder = "/" <> String.trim(r.data, "/")

    entries =
      ftp
      |> paths()
      |> Enum.flat_map(&entry(&1, String.trim_trailing(folder, "/") <> "/"))
      |> Enum.uniq()
      |> Enum.drop(r.offset)

    {ftp, [if(entries == [], do: Packet.nak(r, :eof), else: Packet.ack(r, fitting(entries)))]}
  end

  # --- opening ---

  defp on(ftp, :open, r, params) do
    case content(ftp, r.data, params) do
      nil -> refused(ftp, r, :file_not_found)
      content -> open(ftp, r, %{path: r.data, content: content, write?: false}, Content.size(content))
    end
  end

  defp on(%{files: files} = ftp, operation, r, _params) when operation in [:create, :open_to_write] do
    cond do
      String.starts_with?(r.data, "@") ->
        refused(ftp, r, :failed)

      operation == :open_to_write and not is_map_key(files, r.data) ->
        refused(ftp, r, @enoent)

      map_size(files) >= @max_files and not is_map_key(files, r.data) ->
        refused(ftp, r, @enospc)

      true ->
        open_to_write(ftp, r, if(operation == :create, do: "", else: files[r.data]))
    end
  end

  # --- contents ---

  defp on(ftp, operation, r, _params) when operation in [:read, :burst] do
    with_session(ftp, r, fn ftp, file ->
      case Content.answers(file.content, r, @ending[ftp.style]) do
        {:ok, answers, content} -> {put_session(ftp, r.session, %{file | content: content}), answers}
        :error -> refused(ftp, r, @einval)
      end
    end)
  end

  defp on(ftp, :write, r, _params) do
    with_session(ftp, r, fn ftp, file ->
      if file.write? and r.offset + byte_size(r.data) <= @max_file do
        bytes = ftp.files |> Map.get(file.path, "") |> splice(r.offset, r.data)
        {put_file(ftp, file.path, bytes), [%{Packet.ack(r, "") | size: byte_size(r.data)}]}
      else
        refused(ftp, r, :failed)
      end
    end)
  end

  defp on(ftp, :remove, r, _params) do
    if is_map_key(ftp.files, r.data),
      do: {%{ftp | files: Map.delete(ftp.files, r.data)}, [Packet.ack(r, "")]},
      else: refused(ftp, r, @enoent)
  end

  defp on(ftp, :crc, r, params) do
    case content(ftp, r.data, params) do
      nil -> refused(ftp, r, :file_not_found)
      content -> {ftp, [Packet.ack(r, <<CRC.crc32(Content.bytes(content))::little-32>>)]}
    end
  end

  defp on(ftp, nil, r, _params), do: refused(ftp, r, :unknown_command)

  defp refused(ftp, r, error), do: {ftp, [Packet.nak(r, error)]}

  defp splice(old, offset, data) do
    gap = max(offset - byte_size(old), 0)
    head = binary_part(old, 0, min(offset, byte_size(old)))
    rest = offset + byte_size(data)
    tail = if byte_size(old) > rest, do: binary_part(old, rest, byte_size(old) - rest), else: ""
    head <> <<0::size(gap * 8)>> <> data <> tail
  end

  defp put_file(ftp, path, bytes), do: %{ftp | files: Map.put(ftp.files, path, bytes)}

  # PX4 uses session 0 alone.
  defp open(ftp, r, file, size) do
    case Enum.find(0..(@sessions[ftp.style] - 1), &(not is_map_key(ftp.sessions, &1))) do
      nil ->
        refused(ftp, r, :no_sessions)

      session ->
        {put_session(ftp, session, file), [%{Packet.ack(r, <<size::little-32>>) | session: session}]}
    end
  end

  defp open_to_write(ftp, r, bytes) do
    file = %{path: r.data, content: Content.stored(""), write?: true}

    case open(ftp, r, file, byte_size(bytes)) do
      {^ftp, refused} -> {ftp, refused}
      {ftp, opened} -> {put_file(ftp, r.data, bytes), opened}
    end
  end

  defp put_session(ftp, session, file), do: %{ftp | sessions: Map.put(ftp.sessions, session, file)}

  defp with_session(ftp, r, fun) do
    case Map.fetch(ftp.sessions, r.session) do
      {:ok, file} -> fun.(ftp, file)
      :error -> refused(ftp, r, :invalid_session)
    end
  end

  # Its pieces are those of the largest size, however it is read.
  defp content(%{style: :ardupilot}, path, params) when is_map_key(@packed, path) do
    packed = Params.packed(params)
    Content.made(fn _size -> PackedParams.encode(packed, @packed[path], @max_data) end)
  end

  defp content(ftp, path, _params), do: if(bytes = ftp.files[path], do: Content.stored(bytes))

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
end
