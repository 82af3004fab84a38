defmodule Circuits.UART.Wire do
  @moduledoc false
  # The packets to and from the port program, described in src/wire.h. Decoding is total: any binary becomes an event or
  # `:malformed`, and error names become atoms only by a table.

  alias Circuits.UART.Options

  @errors ~w(eperm enoent eintr eio enxio ebadf eagain enomem eacces ebusy enodev enotdir eisdir einval enfile emfile
             enotty erofs eloop ecanceled eopnotsupp enametoolong etimedout)a
          |> Map.new(&{Atom.to_string(&1), &1})

  @longest_wait 0x7FFFFFFF

  @type id :: 0..0xFFFFFFFF
  @type event ::
          {:ok, id(), binary()}
          | {:error, id(), atom()}
          | {:data, binary()}
          | {:gone, told? :: boolean(), atom()}
          | :malformed

  @spec open(id(), Path.t(), Options.t()) :: iodata()
  def open(id, path, options), do: [<<1, id::32>>, Options.encode(options), path]

  @spec configure(id(), Options.t()) :: iodata()
  def configure(id, options), do: [<<2, id::32>>, Options.encode(options)]

  @spec write(id(), non_neg_integer(), binary()) :: iodata()
  def write(id, timeout, bytes), do: [<<3, id::32, wait(timeout)::32>>, bytes]

  @spec read(id(), non_neg_integer()) :: iodata()
  def read(id, timeout), do: <<4, id::32, wait(timeout)::32>>

  @spec cancel() :: iodata()
  def cancel, do: <<5, 0::32>>

  @spec drain(id(), non_neg_integer()) :: iodata()
  def drain(id, timeout), do: <<6, id::32, wait(timeout)::32>>

  @spec flush(id()) :: iodata()
  def flush(id), do: <<7, id::32>>

  @spec credit(1..0xFFFF) :: iodata()
  def credit(count), do: <<8, count::16>>

  @spec decode(binary()) :: event()
  def decode(<<?o, id::32, result::binary>>), do: {:ok, id, result}
  def decode(<<?e, id::32, name::binary>>), do: {:error, id, error(name)}
  def decode(<<?d, bytes::binary>>) when bytes != "", do: {:data, bytes}
  def decode(<<?g, told, name::binary>>) when told in 0..1, do: {:gone, told == 1, error(name)}
  def decode(_other), do: :malformed

  defp error(name), do: Map.get(@errors, name, :einval)
  defp wait(ms), do: ms |> max(0) |> min(@longest_wait)
end
