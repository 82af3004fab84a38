# On a busy machine everything takes many times as long.
# The tests over PTYs need the port program and their own peer, hence a C compiler.
if File.exists?(Circuits.UART.PortProgram.path()) do
  Circuits.UART.Test.Pty.build!()
  ExUnit.start(assert_receive_timeout: 180_000, timeout: 1_200_000)
else
  IO.puts(:stderr, "no port program: the tests that open a port are left out")
  ExUnit.start(exclude: [:pty], assert_receive_timeout: 180_000, timeout: 1_200_000)
end
