defmodule Circuits.UART.Test.FakeProgram do
  @moduledoc """
  The port program as a value, for properties of `Circuits.UART.Core`: packets go in at once, answers come out in order but
  as late as the property likes. It raises where the real one would end itself (two reads or two writes at once).
  """

  defstruct open: false, active: false, credit: 64, kernel: "", reading: nil, sending: nil, out: :queue.new()

  @doc "A packet from the BEAM's side."
  def packet(fake, iodata), do: iodata |> IO.iodata_to_binary() |> request(fake)

  defp request(<<1, id::32, _speed::32, active, path::binary>>, fake) do
    fake = cancel(fake, "ecanceled")

    if path == "/dev/bad",
      do: error(%{fake | open: false}, id, "enoent"),
      else: ok(%{fake | open: true, active: active == 1, kernel: ""}, id)
  end

  defp request(<<5, 0::32>>, %{reading: nil} = fake), do: fake
  defp request(<<5, 0::32>>, fake), do: ok(%{fake | reading: nil}, fake.reading)
  defp request(<<8, count::16>>, fake), do: push(%{fake | credit: fake.credit + count})
  defp request(<<_type, id::32, _::binary>>, %{open: false} = fake), do: error(fake, id, "ebadf")

  defp request(<<2, id::32, _speed::32, active>>, fake) do
    fake = %{fake | active: active == 1}

    fake =
      if fake.active and fake.reading,
        do: error(%{fake | reading: nil}, fake.reading, "ecanceled"),
        else: fake

    fake |> ok(id) |> push()
  end

  defp request(<<type, id::32, _::binary>>, %{sending: nil} = fake) when type in [3, 6],
    do: %{fake | sending: id}

  defp request(<<4, id::32, _::32>>, %{active: true} = fake), do: error(fake, id, "einval")
  defp request(<<4, id::32, 0::32>>, %{reading: nil, kernel: ""} = fake), do: ok(fake, id)
  defp request(<<4, id::32, _::32>>, %{reading: nil} = fake), do: push(%{fake | reading: id})
  defp request(<<7, id::32>>, fake), do: ok(%{fake | kernel: ""}, id)

  @doc "What happens on the line."
  def line(%{open: false} = fake, _event), do: fake
  def line(fake, {:bytes, bytes}), do: push(%{fake | kernel: fake.kernel <> bytes})
  def line(%{reading: id} = fake, :read_timeout) when id != nil, do: ok(%{fake | reading: nil}, id)
  def line(%{sending: id} = fake, :sent) when id != nil, do: ok(%{fake | sending: nil}, id)

  def line(%{sending: id} = fake, :send_timeout) when id != nil,
    do: error(%{fake | sending: nil}, id, "eagain")

  def line(fake, :hang_up) do
    told = if fake.reading || fake.sending, do: 1, else: 0
    put(%{cancel(fake, "eio") | open: false}, <<?g, told, "eio">>)
  end

  def line(fake, _nothing_waits), do: fake

  @doc "The next packet for the BEAM's side."
  def take(fake) do
    case :queue.out(fake.out) do
      {{:value, packet}, rest} -> {packet, %{fake | out: rest}}
      {:empty, _out} -> :empty
    end
  end

  defp push(%{kernel: ""} = fake), do: fake

  defp push(%{reading: id} = fake) when id != nil, do: ok(%{fake | reading: nil, kernel: ""}, id, fake.kernel)

  defp push(%{active: true, credit: credit} = fake) when credit > 0,
    do: put(%{fake | kernel: "", credit: credit - 1}, <<?d, fake.kernel::binary>>)

  defp push(fake), do: fake

  defp cancel(fake, name) do
    waiting = for id <- [fake.reading, fake.sending], id != nil, do: id
    Enum.reduce(waiting, %{fake | reading: nil, sending: nil}, &error(&2, &1, name))
  end

  defp ok(fake, id, result \\ ""), do: put(fake, <<?o, id::32, result::binary>>)
  defp error(fake, id, name), do: put(fake, <<?e, id::32, name::binary>>)
  defp put(fake, packet), do: %{fake | out: :queue.in(packet, fake.out)}
end
