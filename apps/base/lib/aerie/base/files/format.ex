defmodule Aerie.Base.Files.Format do
  @moduledoc """
  The mark of a folder that outlives the version of Aerie that wrote it: a file `FORMAT` with the kind of its content and
  the version of its format, as `aerie-outbox 1`. A newer version is refused, because files that are half understood are
  worse than none. A folder without a mark has the first version, or is new. A mark that cannot be read, as a power cut
  leaves it, is set aside and counts as none.

  A format changes by a new version, and the part that owns the folder goes on reading the one before.
  """

  alias Aerie.Base.Files.{Damaged, Private}
  alias Aerie.Base.Names

  @name "FORMAT"
  @max_bytes 64

  @type kind :: {name :: String.t(), version :: pos_integer()}

  @doc "Whether a folder can be read by this version of Aerie; the error says what to do."
  @spec check(Path.t(), kind()) :: :ok | {:error, String.t()}
  def check(dir, {name, version}) do
    case read(Path.join(dir, @name)) do
      {:ok, ^name, found} when found > version -> {:error, newer(dir, name, found, version)}
      {:ok, ^name, _found} -> :ok
      {:ok, other, _found} -> {:error, "#{dir} is a folder for #{other}, not for #{name}; name another one"}
      # No folder: the code that makes it reports the reason.
      _none_or_damaged -> :ok
    end
  end

  @doc "Checks a folder and marks it. A mark that cannot be read is set aside, and named (`Aerie.Base.Files.Damaged`)."
  @spec mark(Names.gateway(), Path.t(), kind()) :: :ok | {:error, String.t() | File.posix()}
  def mark(gateway, dir, {name, version} = kind) do
    path = Path.join(dir, @name)
    text = "aerie-#{name} #{version}\n"

    with :ok <- check(dir, kind) do
      case read(path) do
        {:ok, _name, ^version} ->
          :ok

        {:ok, _name, _older} ->
          Private.write(path, text)

        {:error, reason} when reason in [:enoent, :enotdir] ->
          Private.write(path, text)

        _damaged ->
          words = "the folder is read as one of the first version"
          with {:ok, _kept} <- Damaged.set_aside(gateway, path, words), do: Private.write(path, text)
      end
    end
  end

  @doc "The words for a format that is newer than the one that this version of Aerie knows."
  @spec newer(Path.t(), String.t(), term(), pos_integer()) :: String.t()
  def newer(place, name, found, known) do
    "#{place}: written by a newer version of Aerie (#{name} #{found}; this one reads #{known} and older). Use that version, or " <>
      "another folder"
  end

  defp read(path) do
    with {:ok, text} <- File.open(path, [:read, :raw, :binary], &:file.read(&1, @max_bytes)),
         {:ok, text} <- text,
         [_all, name, version] <- Regex.run(~r/\Aaerie-([a-z-]{1,32}) ([0-9]{1,9})\n\z/, text) do
      {:ok, name, String.to_integer(version)}
    else
      {:error, reason} -> {:error, reason}
      _other -> :damaged
    end
  end
end
