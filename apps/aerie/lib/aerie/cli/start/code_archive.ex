defmodule Aerie.CLI.Start.CodeArchive do
  @moduledoc """
  The code that no flight uses, in memory, from where the code server takes it without a file descriptor and without
  a file. Loaded, it would cost seconds at the start and five times the memory.

  The archive is made with the copy of the code that a gateway runs from (`bin/lib/copy_code.exs`, the release). At the
  start it becomes what the code of an escript is: the primary archive of `:erl_prim_loader`, and the first entry of
  the code path.
  """

  # The loader asks for the time of the archive's file at each use, so it needs one that nobody removes.
  @file_name ~c"/dev/null"
  # The same content gives the same bytes.
  @time {{1980, 1, 1}, {0, 0, 0}}

  @doc "Where it is: in the folder `priv` of this application."
  @spec path() :: Path.t()
  def path, do: Application.app_dir(:aerie, "priv/code.zip")

  @doc "Makes it of these modules. `consolidated`: the folder of the consolidated protocols."
  @spec pack(Path.t(), [module()], Path.t()) :: :ok
  def pack(path, modules, consolidated) do
    entries =
      modules |> Task.async_stream(&entry(&1, consolidated), timeout: :infinity) |> Enum.map(&elem(&1, 1))

    # They are compressed already.
    {:ok, {_name, zip}} = :zip.create(~c"code", entries, [:memory, compress: [], extra: []])
    File.write!(path, [<<:erlang.crc32(zip)::32>>, zip])
  end

  defp entry(module, consolidated) do
    code = stripped(module, consolidated)
    # A `:file_info`: its size, and what is the same for all.
    {~c"#{module}.beam", code,
     {:file_info, byte_size(code), :regular, :read, @time, @time, @time, 0o644, 1, 0, 0, 0, 0, 0}}
  end

  defp stripped(module, consolidated) do
    code =
      case File.read(Path.join(consolidated, "#{module}.beam")) do
        {:ok, code} -> code
        {:error, :enoent} -> module |> :code.get_object_code() |> elem(1)
      end

    {:ok, {^module, stripped}} = :beam_lib.strip(code)
    stripped
  end

  @doc "Puts the archive into the code path; `:none` without a file, as in tests, or with a damaged one."
  @spec open(Path.t(), charlist()) :: :ok | :none
  def open(path, name \\ @file_name) do
    with {:ok, <<sum::32, zip::binary>>} <- File.read(path),
         ^sum <- :erlang.crc32(zip),
         {:ok, info} <- :file.read_file_info(name),
         # Asked again if somebody has changed the time of that file.
         again = fn _name -> {:ok, zip} end,
         {:ok, _folders} <- :erl_prim_loader.set_primary_archive(name, zip, info, again),
         true <- :code.add_patha(name) do
      # Only modules that nobody has are looked for in the folders now; what was kept of them takes 4 MB.
      _ = :code.set_path(:code.get_path(), :nocache)
      :ok
    else
      _none -> :none
    end
  end
end
