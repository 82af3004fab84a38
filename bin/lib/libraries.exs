# The libraries of a release: `elixir bin/lib/libraries.exs RELEASE FOLDER NAME ...` copies those that its programs and drivers are linked
# with, and the NAMEs (loaded by name), from FOLDER into RELEASE/usr/lib/, and checks that all of the release is for one architecture.
#
# It reads the ELF files itself instead of asking the loader, because another architecture's loader does not run here.
defmodule Libraries do
  def run(release, folder, names) do
    programs = for path <- Path.wildcard(Path.join(release, "**/*")), elf = elf(path), do: {path, elf}
    libraries = closure(Enum.flat_map(programs, fn {_path, elf} -> elf.needed end) ++ names, folder, %{})
    target = Path.join([release, "usr/lib", Path.basename(folder)])
    for {name, _elf} <- libraries, do: File.cp!(Path.join(folder, name), Path.join(target, name))

    %{"libc.so.6" => %{machine: machine}} = libraries
    for {path, elf} <- programs, elf.machine != machine, do: fail("#{path} is for another architecture")
  end

  defp closure([], _folder, found), do: found
  defp closure([name | names], folder, found) when is_map_key(found, name), do: closure(names, folder, found)

  defp closure([name | names], folder, found) do
    elf = elf(Path.join(folder, name)) || fail("the toolchain lacks #{name}")
    closure(elf.needed ++ names, folder, Map.put(found, name, elf))
  end

  # What a program or library is (64 bits, little-endian, as on both architectures); nil for another file.
  defp elf(path) do
    with true <- File.regular?(path),
         <<0x7F, "ELF", 2, 1, _rest::binary>> <- File.open!(path, [:read, :raw], &IO.binread(&1, 64)) do
      parse(File.read!(path))
    else
      _other -> nil
    end
  end

  defp parse(
         <<_::binary-18, machine::little-16, _::binary-12, start::little-64, _::binary-14, size::little-16, count::little-16,
           _::binary>> = file
       ) do
    segments =
      for <<type::little-32, _flags::32, offset::little-64, address::little-64, _::64, length::little-64, _::binary>> <-
            for(n <- 0..(count - 1)//1, do: binary_part(file, start + n * size, size)),
          do: %{type: type, offset: offset, address: address, length: length}

    %{machine: machine, needed: needed(file, segments)}
  end

  @load 1
  @dynamic 2
  @needed 1
  @strings 5

  defp needed(file, segments) do
    entries =
      for %{type: @dynamic} = segment <- segments,
          <<tag::little-64, value::little-64 <- binary_part(file, segment.offset, segment.length)>>,
          do: {tag, value}

    case List.keyfind(entries, @strings, 0) do
      {@strings, address} ->
        load = Enum.find(segments, &(&1.type == @load and address in &1.address..(&1.address + &1.length)))
        for {@needed, at} <- entries, do: text(file, load.offset + address - load.address + at)

      # Linked with nothing.
      nil ->
        []
    end
  end

  defp text(file, at) do
    <<_::binary-size(^at), rest::binary>> = file
    rest |> :binary.split(<<0>>) |> hd()
  end

  defp fail(message) do
    IO.puts(:stderr, message)
    System.halt(1)
  end
end

[release, folder | names] = System.argv()
Libraries.run(release, folder, names)
