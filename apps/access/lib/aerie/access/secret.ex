defmodule Aerie.Access.Secret do
  @moduledoc "The secret that signs sessions: 32 random bytes in a file that only its owner can read, so that a restart signs nobody out."

  alias Aerie.Base.Names
  alias Aerie.Access.PrivateFile

  @bytes 32

  @doc "The secret of a folder, created if there is none."
  @spec load(Names.gateway(), Path.t()) :: {:ok, binary()} | {:error, String.t()}
  def load(gateway, dir) do
    path = Path.join(dir, "secret")

    case File.read(path) do
      {:ok, <<_::binary-size(@bytes)>> = secret} -> {:ok, secret}
      {:error, :enoent} -> make(path)
      _damaged -> renew(gateway, path)
    end
  end

  defp renew(gateway, path) do
    with {:ok, nil} <- PrivateFile.set_aside(gateway, path, "everybody has to sign in again", nil),
         do: make(path)
  end

  defp make(path) do
    secret = :crypto.strong_rand_bytes(@bytes)
    with :ok <- PrivateFile.write(path, secret), do: {:ok, secret}
  end
end
