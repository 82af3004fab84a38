defmodule MavRouter.Signing.Key do
  @moduledoc """
  Where a signing key comes from: a file that only its owner can read, an environment variable, or random bytes.

  A key is 32 bytes. As text it is one of

  | text | key |
  |---|---|
  | 64 hexadecimal digits | those bytes |
  | 44 characters of base64 that make 32 bytes | those bytes |
  | anything else | a passphrase: its SHA-256, as QGroundControl, Mission Planner and MAVProxy do |

  A prefix `hex:`, `base64:` or `passphrase:` says which, for a passphrase that looks like a key. White space around the text is
  ignored. A file of exactly 32 bytes that are not text is the key itself.

  A key is held only as `Aerie.Base.Secret`, and no error of this module contains any of it.
  """

  import Bitwise

  alias Aerie.Base.Secret

  @max_bytes 4096
  @size 32

  @typedoc "Where to look: a file, an environment variable, text as above."
  @type source :: {:file, Path.t()} | {:env, String.t()} | {:text, String.t()}

  @doc "Reads a key. The error is a text for the operator."
  @spec read(source) :: {:ok, Secret.t()} | {:error, String.t()}
  def read({:text, text}), do: parse(text)

  def read({:env, name}) do
    case System.get_env(name, "") do
      "" -> {:error, "environment variable #{name} is not set"}
      text -> with {:error, reason} <- parse(text), do: {:error, "environment variable #{name}: #{reason}"}
    end
  end

  def read({:file, path}) do
    with {:ok, stat} <- stat(path),
         :ok <- regular(path, stat),
         :ok <- private(path, stat),
         {:ok, text} <- text(path) do
      with {:error, reason} <- parse(text), do: {:error, "#{path}: #{reason}"}
    end
  end

  defp stat(path) do
    with {:error, reason} <- File.stat(path), do: {:error, "#{path}: #{reason_text(reason)}"}
  end

  defp regular(_path, %{type: :regular, size: size}) when size <= @max_bytes, do: :ok

  defp regular(path, %{type: :regular}),
    do: {:error, "#{path}: is too long for a key (more than #{@max_bytes} bytes)"}

  defp regular(path, _stat), do: {:error, "#{path}: is not a file"}

  # Reading the key is enough to fly the vehicle; writing it is enough to lock its owner out.
  defp private(path, %{mode: mode}) do
    case mode &&& 0o077 do
      0 ->
        :ok

      _others ->
        octal = (mode &&& 0o7777) |> Integer.to_string(8) |> String.pad_leading(4, "0")

        {:error,
         "#{path}: its mode is #{octal}, so that not only its owner can use the key: chmod 600 #{path}"}
    end
  end

  defp text(path) do
    with {:error, reason} <- File.read(path), do: {:error, "#{path}: #{reason_text(reason)}"}
  end

  defp reason_text(reason), do: reason |> :file.format_error() |> to_string()

  @doc "A key from text, see above."
  @spec parse(binary) :: {:ok, Secret.t()} | {:error, String.t()}
  def parse(bytes) when byte_size(bytes) == @size do
    if String.printable?(bytes), do: named(String.trim(bytes)), else: {:ok, Secret.new(bytes)}
  end

  def parse(text) do
    if String.valid?(text),
      do: named(String.trim(text)),
      else: {:error, "the key is neither text nor #{@size} bytes"}
  end

  defp named(""), do: {:error, "the key is empty"}
  defp named("hex:" <> digits), do: must(hex(digits), "64 hexadecimal digits after hex:")
  defp named("base64:" <> text), do: must(base64(text), "base64 of #{@size} bytes after base64:")
  defp named("passphrase:" <> phrase), do: passphrase(phrase)

  defp named(text) do
    with :error <- hex(text), :error <- base64(text), do: passphrase(text)
  end

  defp passphrase(""), do: {:error, "the passphrase is empty"}
  defp passphrase(phrase), do: {:ok, Secret.new(MavCodec.Signing.key(phrase))}

  defp must({:ok, secret}, _expected), do: {:ok, secret}
  defp must(:error, expected), do: {:error, "the key must be #{expected}"}

  defp hex(digits), do: bytes(Base.decode16(digits, case: :mixed))
  defp base64(text), do: bytes(Base.decode64(text))

  # 32 zeros switch signing off.
  defp bytes({:ok, <<0::size(@size)-unit(8)>>}), do: :error
  defp bytes({:ok, <<_::binary-size(@size)>> = key}), do: {:ok, Secret.new(key)}
  defp bytes(_other), do: :error

  @doc "A new key from the system's random numbers."
  @spec generate() :: Secret.t()
  def generate, do: Secret.new(:crypto.strong_rand_bytes(@size))

  @doc "Whether two keys are the same."
  @spec same?(Secret.t() | nil, Secret.t() | nil) :: boolean
  def same?(nil, nil), do: true
  def same?(nil, _key), do: false
  def same?(_key, nil), do: false
  def same?(one, other), do: :crypto.hash_equals(Secret.reveal(one), Secret.reveal(other))
end
