defmodule FleetWeb.Access.Secret do
  @moduledoc "The secret that signs sessions: 32 random bytes in a file that only its owner can read, so that a restart signs nobody out."

  alias Aerie.Base.Files.{Damaged, Private}
  alias Aerie.Base.Names

  @bytes 32

  @doc "The secret of a folder, created if there is none."
  @spec load(Names.gateway(), Path.t()) :: {:ok, binary()} | {:error, String.t()}
  def load(gateway, dir) do
    path = Path.join(dir, "secret")

    case File.read(path) do
      {:ok, <<_::binary-size(@bytes)>> = secret} -> {:ok, secret}
      {:error, :enoent} -> make(dir, path)
      _damaged -> renew(gateway, dir, path)
    end
  end

  defp renew(gateway, dir, path) do
    with {:ok, _kept} <- Damaged.set_aside(gateway, path, "everybody has to sign in again"),
         do: make(dir, path),
         else: ({:error, reason} -> {:error, "#{path}: #{:file.format_error(reason)}"})
  end

  defp make(dir, path) do
    secret = :crypto.strong_rand_bytes(@bytes)

    with :ok <- Private.new_folder(dir), :ok <- Private.write(path, secret) do
      {:ok, secret}
    else
      {:error, reason} -> {:error, "#{path}: #{:file.format_error(reason)}"}
    end
  end
end
