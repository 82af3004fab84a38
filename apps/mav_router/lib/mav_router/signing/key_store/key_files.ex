defmodule MavRouter.Signing.KeyStore.KeyFiles do
  @moduledoc """
  The keys that vehicles were given, in `signing.dir/keys`, one file each, for its owner only:

  | file | |
  |---|---|
  | `main-7.key` | the key that the vehicle has |
  | `main-7.key.next` | the one that it may have: it was sent, and no frame signed with it has come yet |
  | `main-7.key.previous` | the one that it had before, for going back |

  A key is forced to the disk before it is sent to a vehicle, so that one of the three is the vehicle's whatever happens. A file that
  others can read is refused, like any other key file (`MavRouter.Signing.Key`).
  """

  alias Aerie.Base.Secret
  alias MavRouter.Signing.Key
  alias MavRouter.Signing.KeyStore.State

  @max_files 4096
  @name ~r/\A([A-Za-z0-9_-]{1,64})-([0-9]{1,10})\.key(\.next)?\z/

  @type kind :: :current | :next | :previous
  @type id :: {network :: String.t(), system :: non_neg_integer}

  @doc "The path of a key."
  @spec path(Path.t(), id, kind) :: Path.t()
  def path(dir, {network, system}, kind),
    do: Path.join([dir, "keys", "#{network}-#{system}.key#{suffix(kind)}"])

  defp suffix(:current), do: ""
  defp suffix(:next), do: ".next"
  defp suffix(:previous), do: ".previous"

  @doc "The vehicles that have a key of a kind; none without a folder."
  @spec list(Path.t() | nil, :current | :next) :: [id]
  def list(nil, _kind), do: []

  def list(dir, kind) do
    with {:ok, names} <- File.ls(Path.join(dir, "keys")) do
      suffix = suffix(kind)

      for name <- names |> Enum.sort() |> Enum.take(@max_files),
          [_, network, system | found] <- [Regex.run(@name, name)],
          Enum.join(found) == suffix,
          do: {network, String.to_integer(system)}
    else
      {:error, _none} -> []
    end
  end

  @doc "Reads a key."
  @spec read(Path.t(), id, kind) :: {:ok, Secret.t()} | {:error, String.t()}
  def read(dir, id, kind), do: Key.read({:file, path(dir, id, kind)})

  @doc "Writes a key, whole or not at all; it is on the disk when this returns."
  @spec write(Path.t(), id, kind, Secret.t()) :: :ok | {:error, String.t()}
  def write(dir, id, kind, secret) do
    text = "hex:" <> Base.encode16(Secret.reveal(secret), case: :lower) <> "\n"
    with :ok <- State.folder(dir), do: State.write(path(dir, id, kind), text)
  end

  @doc "The vehicle has proven that it has a key; the former one, if any, becomes the previous."
  @spec promote(Path.t(), id, Secret.t(), Secret.t() | nil) :: :ok | {:error, String.t()}
  def promote(dir, id, secret, former) do
    with :ok <- if(former, do: write(dir, id, :previous, former), else: :ok),
         :ok <- write(dir, id, :current, secret),
         do: remove(dir, id, :next)
  end

  @doc "The vehicle has no key of its own any more."
  @spec retire(Path.t(), id) :: :ok | {:error, String.t()}
  def retire(dir, id) do
    with :ok <- remove(dir, id, :next) do
      if File.exists?(path(dir, id, :current)),
        do: move(path(dir, id, :current), path(dir, id, :previous)),
        else: :ok
    end
  end

  @doc "Removes a key, if it is there."
  @spec remove(Path.t(), id, kind) :: :ok | {:error, String.t()}
  def remove(dir, id, kind) do
    case File.rm(path(dir, id, kind)) do
      {:error, reason} when reason != :enoent -> file_error(path(dir, id, kind), reason)
      _gone -> :ok
    end
  end

  defp move(from, to) do
    with {:error, reason} <- File.rename(from, to), do: file_error(to, reason)
  end

  defp file_error(path, reason), do: {:error, "#{path}: #{:file.format_error(reason)}"}
end
