defmodule Aerie.Base.Files.Raw do
  @moduledoc """
  Operations on files that the calling process does itself. Names and results are those of `File`, whose operations one process does for
  the whole node, one after the other: one that waits for its disk holds up all, and on a busy machine each waits for those before it. So
  these are for a disk that may hang, and for looking at thousands of files.
  """

  require Record
  Record.defrecordp(:file_info, Record.extract(:file_info, from_lib: "kernel/include/file.hrl"))

  @type result :: :ok | {:error, File.posix()}

  @doc "Times are unix seconds."
  @spec stat(Path.t()) :: {:ok, File.Stat.t()} | {:error, File.posix()}
  def stat(path), do: path |> :file.read_file_info([:raw, time: :posix]) |> stat_of()

  @spec lstat(Path.t()) :: {:ok, File.Stat.t()} | {:error, File.posix()}
  def lstat(path), do: path |> :file.read_link_info([:raw, time: :posix]) |> stat_of()

  defp stat_of({:ok, record}), do: {:ok, File.Stat.from_record(record)}
  defp stat_of(error), do: error

  @spec exists?(Path.t()) :: boolean
  def exists?(path), do: match?({:ok, _stat}, stat(path))

  @spec dir?(Path.t()) :: boolean
  def dir?(path), do: match?({:ok, %{type: :directory}}, stat(path))

  @spec read(Path.t()) :: {:ok, binary} | {:error, File.posix()}
  def read(path), do: :file.read_file(path, [:raw])

  @spec append(Path.t(), iodata) :: result
  def append(path, bytes) do
    with {:ok, file} <- :file.open(path, [:append, :raw, :binary]) do
      written = :file.write(file, bytes)
      with :ok <- :file.close(file), do: written
    end
  end

  @spec chmod(Path.t(), non_neg_integer) :: result
  def chmod(path, mode), do: :file.write_file_info(path, file_info(mode: mode), [:raw])

  @spec rm(Path.t()) :: result
  def rm(path), do: :file.delete(path, [:raw])

  # For the following `:file` has no such option.

  @spec rename(Path.t(), Path.t()) :: result
  def rename(from, to), do: :prim_file.rename(from, to)

  @spec ls(Path.t()) :: {:ok, [String.t()]} | {:error, File.posix()}
  def ls(path) do
    with {:ok, names} <- :prim_file.list_dir(path), do: {:ok, Enum.map(names, &IO.chardata_to_string/1)}
  end

  @spec read_link(Path.t()) :: {:ok, String.t()} | {:error, File.posix()}
  def read_link(path) do
    with {:ok, target} <- :prim_file.read_link(path), do: {:ok, IO.chardata_to_string(target)}
  end

  @spec mkdir_p(Path.t()) :: result
  def mkdir_p(path) do
    above = Path.dirname(path)

    # The folder above is missing, unless the path has none.
    with {:error, :enoent} when above != path <- mkdir(path),
         :ok <- mkdir_p(above),
         do: mkdir(path)
  end

  defp mkdir(path) do
    with {:error, :eexist} <- :prim_file.make_dir(path), do: if(dir?(path), do: :ok, else: {:error, :enotdir})
  end
end
