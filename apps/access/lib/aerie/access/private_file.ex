defmodule Aerie.Access.PrivateFile do
  @moduledoc """
  The files of users, keys, sessions and the secret. Only their owner can read them; one that others can read is
  refused, because its owner has to decide what that means, and a damaged one is set aside (`Aerie.Base.Files.Damaged`).
  """

  import Bitwise

  alias Aerie.Base.Files.{Damaged, Private}
  alias Aerie.Base.Names

  @most 65_536

  @doc "The content of a file; `:enoent` if there is no file. Any other error is a text that names it."
  @spec read(Path.t()) :: {:ok, binary()} | {:error, :enoent | String.t()}
  def read(path) do
    with {:ok, stat} <- File.stat(path), :ok <- private(path, stat), {:ok, content} <- File.read(path) do
      {:ok, content}
    else
      {:error, :enoent} -> {:error, :enoent}
      {:error, reason} -> {:error, error(path, reason)}
    end
  end

  defp private(path, %File.Stat{type: :regular, mode: mode, size: size}) do
    cond do
      (mode &&& 0o077) != 0 ->
        {:error, "others can read it (mode #{Integer.to_string(mode &&& 0o777, 8)}): chmod 600 #{path}"}

      size > @most ->
        {:error, "it is larger than #{@most} bytes"}

      true ->
        :ok
    end
  end

  defp private(_path, _stat), do: {:error, "it is not a file"}

  @doc "Writes a file, and makes its folder if there is none."
  @spec write(Path.t(), iodata()) :: :ok | {:error, String.t()}
  def write(path, content) do
    with :ok <- Private.new_folder(Path.dirname(path)), :ok <- Private.write(path, content) do
      :ok
    else
      {:error, reason} -> {:error, error(path, reason)}
    end
  end

  @doc "What `read` finds in a file. A damaged one is set aside for `instead`; `words` say what follows from it."
  @spec open(Names.gateway(), Path.t(), (Path.t() -> {:ok, held} | {:error, String.t()}), String.t(), held) ::
          {:ok, held} | {:error, String.t()}
        when held: term()
  def open(gateway, path, read, words, instead) do
    with {:error, text} <- read.(path) do
      if Damaged.damaged?(path), do: set_aside(gateway, path, words, instead), else: {:error, text}
    end
  end

  @doc "Sets a damaged file aside, and gives what is used instead."
  @spec set_aside(Names.gateway(), Path.t(), String.t(), held) :: {:ok, held} | {:error, String.t()}
        when held: term()
  def set_aside(gateway, path, words, instead) do
    case Damaged.set_aside(gateway, path, words) do
      {:ok, _kept} -> {:ok, instead}
      {:error, reason} -> {:error, error(path, reason)}
    end
  end

  defp error(path, reason) when is_atom(reason), do: "#{path}: #{:file.format_error(reason)}"
  defp error(path, words), do: "#{path}: #{words}"
end
