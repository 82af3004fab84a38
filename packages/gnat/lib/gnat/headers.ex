defmodule Gnat.Headers do
  @moduledoc """
  The header block of a message: `NATS/1.0[ status[ description]]`, then `Name: value` lines.

  Sending is strict, because a line break inside a value would forge headers. Receiving is lenient: the server forwards
  any client's headers, and a bad one must not cost this client its connection. A line without a colon is skipped.
  Names are in lower case, values without surrounding blanks.
  """

  @version "NATS/1.0"

  @type t :: [{String.t(), iodata()}]
  @type decoded :: %{
          status: String.t() | nil,
          description: String.t() | nil,
          headers: [{String.t(), String.t()}]
        }

  @doc "The whole block, with the version line and the empty line at its end."
  @spec encode(t()) :: {:ok, iodata()} | {:error, Gnat.Error.t()}
  def encode(headers), do: encode(headers, [@version, "\r\n"])

  defp encode([], block), do: {:ok, [block, "\r\n"]}

  defp encode([{name, value} | rest], block) do
    value = IO.iodata_to_binary(value)

    if name?(name) and value?(value) do
      encode(rest, [block, name, ": ", value, "\r\n"])
    else
      {:error, Gnat.Error.new({:invalid_header, {name, value}})}
    end
  end

  defp encode([other | _rest], _block), do: {:error, Gnat.Error.new({:invalid_header, other})}

  @doc "Reads a block. Never fails: what is not a header is not in the result."
  @spec decode(binary()) :: decoded()
  def decode(block) do
    [first | lines] = :binary.split(block, "\r\n", [:global])
    {status, description} = status(first)
    %{status: status, description: description, headers: Enum.flat_map(lines, &line/1)}
  end

  defp status(@version <> rest) do
    case rest |> String.trim() |> :binary.split(" ") do
      [""] -> {nil, nil}
      [status] -> {status, nil}
      [status, description] -> {status, String.trim_leading(description)}
    end
  end

  defp status(_other), do: {nil, nil}

  defp line(line) do
    case :binary.split(line, ":") do
      [name, value] when name != "" -> [{String.downcase(name, :ascii), trim(value)}]
      _no_header -> []
    end
  end

  # Not String.trim: the bytes are somebody else's and need not be UTF-8.
  defp trim(<<blank, rest::binary>>) when blank in [?\s, ?\t], do: trim(rest)
  defp trim(value), do: trim_end(value, byte_size(value))

  defp trim_end(value, size) when size > 0 do
    if :binary.at(value, size - 1) in [?\s, ?\t],
      do: trim_end(value, size - 1),
      else: binary_part(value, 0, size)
  end

  defp trim_end(_value, 0), do: ""

  defp name?(<<_, _::binary>> = name), do: name_bytes?(name)
  defp name?(_empty_or_other), do: false

  defp name_bytes?(<<byte, rest::binary>>) when byte > 32 and byte < 127 and byte != ?:, do: name_bytes?(rest)
  defp name_bytes?(rest), do: rest == ""

  defp value?(<<byte, rest::binary>>) when byte not in [?\r, ?\n], do: value?(rest)
  defp value?(rest), do: rest == ""
end
