defmodule Aerie.Fleet.Replay.Source do
  @moduledoc """
  Reads the bytes of a recording: a tlog file, gzipped or not, several in succession, or chunks of any size. A file is
  read chunk by chunk, so its size costs no memory.
  """

  alias MavCodec.{Frame, Tlog}
  alias MavCodec.Msp.Trace

  @chunk 65_536
  @looked_at 16

  @typedoc "A path, paths in the order in which they were written, or pieces of a tlog's bytes."
  @type t :: Path.t() | [Path.t()] | {:chunks, Enumerable.t(binary)}

  @doc """
  Reduces over the frames and damaged parts of a recording, without traces of MSP (`MavCodec.Msp.Trace`), which no
  vehicle sent. The error is a text that names the file.
  """
  @spec reduce(t, [MavCodec.Parser.option()], acc, (Frame.t() | Tlog.Damage.t(), acc -> acc)) ::
          {:ok, acc} | {:error, String.t()}
        when acc: term
  def reduce(source, options, acc, fun),
    do: all(source, options, acc, fn item, acc -> if trace?(item), do: acc, else: fun.(item, acc) end)

  defp trace?(%Frame{} = frame), do: Trace.frame?(frame)
  defp trace?(_damage), do: false

  @doc "The same with traces of MSP."
  @spec all(t, [MavCodec.Parser.option()], acc, (Frame.t() | Tlog.Damage.t(), acc -> acc)) ::
          {:ok, acc} | {:error, String.t()}
        when acc: term
  def all({:chunks, chunks}, options, acc, fun) do
    {acc, decoder} = Enum.reduce(chunks, {acc, Tlog.Decoder.new(options)}, &push(&1, &2, fun))
    {:ok, Enum.reduce(Tlog.Decoder.finish(decoder), acc, fun)}
  end

  def all([_ | _] = paths, options, acc, fun) do
    Enum.reduce_while(paths, {:ok, acc}, fn path, {:ok, acc} ->
      case all(path, options, acc, fun) do
        {:ok, acc} -> {:cont, {:ok, acc}}
        {:error, reason} -> {:halt, {:error, reason}}
      end
    end)
  end

  def all([], _options, _acc, _fun), do: {:error, "no recording was given"}

  def all(path, options, acc, fun) do
    opened(path, &read(&1, {acc, Tlog.Decoder.new(options)}, 0, fun))
  end

  @doc """
  Whether a file has a MAVLink frame in its first mebibyte, as every recording has. The error is a text that names the
  file.
  """
  @spec recording(Path.t()) :: :ok | {:error, String.t()}
  def recording(path),
    do: with({:ok, _found} <- opened(path, &first(&1, Tlog.Decoder.new([]), @looked_at)), do: :ok)

  defp first(_device, decoder, 0), do: none(Tlog.Decoder.finish(decoder))

  defp first(device, decoder, left) do
    case :file.read(device, @chunk) do
      {:ok, bytes} ->
        {items, decoder} = Tlog.Decoder.push(decoder, bytes)
        decided(items) || first(device, decoder, left - 1)

      :eof ->
        items = Tlog.Decoder.finish(decoder)
        decided(items) || none(items)

      {:error, reason} ->
        {:error, reason}
    end
  end

  defp decided(items) do
    Enum.find_value(items, fn
      %Tlog.Damage{kind: :raw} = raw -> {:error, Tlog.Damage.format(raw)}
      %Frame{} -> {:ok, :found}
      %Tlog.Damage{} -> nil
    end)
  end

  defp none([%Tlog.Damage{kind: :untimed} = untimed | _]), do: {:error, Tlog.Damage.format(untimed)}
  defp none(_items), do: {:error, "not a recording: no MAVLink frame found"}

  # `:compressed` also reads files that are not gzipped.
  defp opened(path, fun) do
    with {:ok, device} <- :file.open(path, [:read, :raw, :binary, :compressed]) do
      try do
        fun.(device)
      after
        :file.close(device)
      end
    end
    |> named(path)
  end

  defp read(device, {acc, decoder} = state, size, fun) do
    case :file.read(device, @chunk) do
      {:ok, bytes} -> read(device, push(bytes, state, fun), size + byte_size(bytes), fun)
      :eof when size == 0 -> {:error, "the file is empty"}
      :eof -> {:ok, Enum.reduce(Tlog.Decoder.finish(decoder), acc, fun)}
      {:error, reason} -> {:error, reason}
    end
  end

  defp push(bytes, {acc, decoder}, fun) do
    {items, decoder} = Tlog.Decoder.push(decoder, bytes)
    {Enum.reduce(items, acc, fun), decoder}
  end

  # Damaged gzip data is also reported as an I/O error.
  defp named({:error, :eio}, path), do: {:error, "#{path}: damaged gzip data, or a disk error"}

  defp named({:error, reason}, path) when is_atom(reason),
    do: {:error, "#{path}: #{:file.format_error(reason)}"}

  defp named({:error, text}, path), do: {:error, "#{path}: #{text}"}
  defp named({:ok, acc}, _path), do: {:ok, acc}
end
