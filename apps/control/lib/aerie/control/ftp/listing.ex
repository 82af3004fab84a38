defmodule Aerie.Control.Ftp.Listing do
  @moduledoc """
  The entries of a directory received so far. The vehicle sends as many as fit into each answer.

  Fields of an entry are separated by tabs: the name, the size (of a folder some firmware sends one as well), and what
  newer firmware adds. The folder itself and the one above it are left out.
  """

  alias Aerie.Control.Ftp.Name

  @max 10_000

  defstruct entries: [], offset: 0

  @typedoc "`offset`: the number of the entry to ask for next; `name`: as `Aerie.Control.Ftp.Name` writes it"
  @type t :: %__MODULE__{entries: [entry()], offset: non_neg_integer()}
  @type entry :: %{kind: :file | :directory, name: String.t(), size: non_neg_integer() | nil}

  @doc "The most entries that a directory may have."
  @spec max() :: pos_integer()
  def max, do: @max

  @doc """
  Adds the entries of one answer; `:ended` if it has none. Names end with NUL; `S` is an entry that is left out, but
  counted.
  """
  @spec took(t(), binary()) :: {:more, t()} | :ended | :too_large
  def took(listing, data) do
    case :binary.split(data, <<0>>, [:global, :trim_all]) do
      [] ->
        :ended

      names ->
        entries = names |> Enum.flat_map(&entry/1) |> Enum.reverse(listing.entries)

        if length(entries) > @max,
          do: :too_large,
          else: {:more, %{listing | entries: entries, offset: listing.offset + length(names)}}
    end
  end

  @doc "All entries, in the vehicle's order."
  @spec entries(t()) :: [entry()]
  def entries(listing), do: Enum.reverse(listing.entries)

  defp entry(<<kind, entry::binary>>) when kind in [?D, ?F] do
    case :binary.split(entry, "\t", [:global]) do
      [name | _fields] when name in ["", ".", ".."] -> []
      [name | _fields] when kind == ?D -> [%{kind: :directory, name: Name.text(name), size: nil}]
      [name, size | _fields] -> [%{kind: :file, name: Name.text(name), size: size(Integer.parse(size))}]
      [name] -> [%{kind: :file, name: Name.text(name), size: nil}]
    end
  end

  defp entry(_skipped), do: []

  defp size({size, ""}) when size >= 0, do: size
  defp size(_unreadable), do: nil
end
