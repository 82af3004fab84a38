defmodule FleetWeb.Console.Access.Secret do
  @moduledoc "The secret that signs sessions: 32 random bytes in a file that only its owner can read, so that a restart signs nobody out."

  alias Aerie.PrivateFile

  @bytes 32

  @doc "The secret of a folder, created if there is none."
  @spec load(Path.t()) :: {:ok, binary()} | {:error, String.t()}
  def load(dir) do
    path = Path.join(dir, "secret")

    case File.read(path) do
      {:ok, <<_::binary-size(@bytes)>> = secret} -> {:ok, secret}
      {:ok, _other} -> {:error, "#{path}: expected #{@bytes} bytes; remove it, and a new one is made"}
      {:error, :enoent} -> make(dir, path)
      {:error, reason} -> {:error, "#{path}: #{:file.format_error(reason)}"}
    end
  end

  defp make(dir, path) do
    secret = :crypto.strong_rand_bytes(@bytes)

    with :ok <- PrivateFile.new_folder(dir), :ok <- PrivateFile.write(path, secret) do
      {:ok, secret}
    else
      {:error, reason} -> {:error, "#{path}: #{:file.format_error(reason)}"}
    end
  end
end
