(function () {
  var b = document.body, from = +b.dataset.from, to = +b.dataset.to, out = document.getElementById("at");
  var plots = document.querySelectorAll("svg.plot"), left = +b.dataset.left, inner = +b.dataset.inner, width = +b.dataset.width;
  plots.forEach(function (svg) {
    svg.addEventListener("mousemove", function (e) {
      var box = svg.getBoundingClientRect(), x = (e.clientX - box.left) * width / box.width;
      var part = Math.min(1, Math.max(0, (x - left) / inner));
      plots.forEach(function (p) {
        var line = p.querySelector(".cursor");
        line.setAttribute("x1", left + part * inner);
        line.setAttribute("x2", left + part * inner);
      });
      out.textContent = new Date(from + part * (to - from)).toISOString().replace("T", " ");
      out.style.display = "block";
    });
  });
})();
